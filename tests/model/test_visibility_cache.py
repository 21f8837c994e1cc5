"""The visibility cache skips only rows that a training image does not show."""

import numpy as np
import pytest
import torch

import hybridworldsim.model.visibility_cache as module
from hybridworldsim.model.visibility_cache import VisibilityCache
from hybridworldsim.trainable.viewpoint import to_viewpoint
from tests.model.streets import view
from tests.training.street import Painted, trainer, views

HERE, THERE = to_viewpoint(view(), np.zeros(3)), to_viewpoint(view(1.0), np.zeros(3))


def rows(*numbers):
    return torch.tensor(numbers, dtype=torch.int64)


def test_hidden_rows_are_skipped_until_the_fourth_visit():
    cache, numbers, visible = VisibilityCache(), [torch.arange(20), torch.arange(3)], [rows(1, 4, 19), rows(0, 2)]
    assert [one.tolist() for one in cache.select_rows(HERE, visible, numbers)] == [[1, 4, 19], [0, 2]]
    for _ in range(2):
        for visit in range(4):
            full = visit == 0
            kept = cache.select_rows(HERE, visible, numbers)
            assert [one.tolist() for one in kept] == ([[1, 4, 19], [0, 2]] if full else [[4], []])
            assert [len(one) for one in cache.select_rows(THERE, visible, numbers)] == [3, 2]
            cache.record(HERE, [rows(4), rows()], numbers)


@pytest.mark.parametrize("count", [1, 7, 8, 9, 16])
def test_new_rows_are_never_skipped(count):
    cache = VisibilityCache()
    cache.record(HERE, [rows()], [torch.arange(count)])
    kept = torch.tensor([0, *range(count, count + 20)])
    (found,) = cache.select_rows(HERE, [torch.arange(len(kept))], [kept])
    assert found.tolist() == list(range(1, 21))


def test_rows_keep_their_visibility_when_others_are_removed():
    cache = VisibilityCache()
    cache.record(HERE, [rows(2, 5)], [torch.arange(8)])
    (found,) = cache.select_rows(HERE, [rows(0, 1, 2, 3)], [rows(1, 2, 5, 9)])
    assert found.tolist() == [1, 2, 3]


def test_nodes_may_be_empty():
    cache = VisibilityCache()
    cache.record(HERE, [rows()], [rows()])
    assert cache.select_rows(HERE, [rows()], [rows()])[0].tolist() == []
    assert cache.select_rows(HERE, [rows(0)], [rows(0)])[0].tolist() == [0]


def test_visibility_cache_stays_within_its_byte_limit(monkeypatch):
    monkeypatch.setattr(module, "MAX_BYTES", 2)
    cache, numbers = VisibilityCache(), [torch.arange(8)]
    places = [to_viewpoint(view(float(x)), np.zeros(3)) for x in range(5)]
    for place in places:
        cache.record(place, [rows()], numbers)
    assert [len(cache.select_rows(place, [rows(0)], numbers)[0]) for place in places] == [0, 0, 1, 1, 1]


def test_restored_cache_continues_exactly():
    one, numbers = VisibilityCache(), [torch.arange(50), rows()]
    for place, visits in ((HERE, 2), (THERE, 4)):
        for _ in range(visits):
            one.record(place, [rows(3, 40), rows()], numbers)
    other = VisibilityCache()
    other.restore(one.state())
    for _ in range(6):
        for place in (HERE, THERE):
            found, expected = (each.select_rows(place, [torch.arange(50), rows()], numbers) for each in (one, other))
            assert all(torch.equal(a, b) for a, b in zip(found, expected))
            one.record(place, [rows(3), rows()], numbers)
            other.record(place, [rows(3), rows()], numbers)
    empty = VisibilityCache()
    empty.restore(VisibilityCache().state())
    assert len(empty.select_rows(HERE, [rows(0)], [rows(0)])[0]) == 1


def walled():
    """A trainable street with opaque sky Gaussians in front of the left half of the first view."""
    one, generator = trainer(), torch.Generator().manual_seed(0)
    sky, some = one.street.sky, slice(0, 50)
    places = torch.rand(50, 3, generator=generator) * torch.tensor((0.1, 5.0, 6.0))
    sky.means.data[some] = places + torch.tensor((3.0, 0.5, -1.5))
    sky.quats.data[some] = torch.tensor((1.0, 0.0, 0.0, 0.0))
    sky.log_scales.data[some] = torch.tensor((-2.0, 0.4, 0.4))
    sky.logits.data[some] = 9.0
    return one


def test_skipping_hidden_rows_does_not_change_a_step():
    one, image = walled(), Painted()(views(1)[0])
    before = {name: table.clone() for name, table in one.state().items()}
    visible = len(one.street.background.visible_ids(image.viewpoint))
    found = []
    for _ in range(2):
        losses = one.step(image, 0.0).losses
        one.catch_up()
        found.append((losses, {name: table.detach().clone() for name, table in one.street.named_parameters()}))
        known = {name: table.clone() for name, table in one.state().items() if name.startswith("sightings.")}
        one.restore({**before, **known})
    assert 0 < len(one.visible_rows(image.viewpoint).background.ids) < 0.8 * visible
    (losses, tables), (other_losses, other_tables) = found
    assert losses == pytest.approx(other_losses, rel=1e-5)
    for name, table in tables.items():
        torch.testing.assert_close(other_tables[name], table, rtol=1e-4, atol=1e-5, msg=name)
    assert not torch.equal(before["model.background.offsets"], tables["background.offsets"])
