from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hybridworldsim.kernels.dispatch import plain_torch
from hybridworldsim.model.appearance import AppearanceLatents
from hybridworldsim.model.blocks import Block
from hybridworldsim.model.composition import Composition
from hybridworldsim.model.partition import partition
from hybridworldsim.model.parts import split_street
from hybridworldsim.model.splats import concatenate_splats
from hybridworldsim.model.street import StreetModel
from hybridworldsim.rasterizer import covers as covers_module
from hybridworldsim.rasterizer import rasterization
from hybridworldsim.rasterizer.covers import covered_before
from hybridworldsim.trainable.viewpoint import to_viewpoint
from mirror.metrics.images.psnr import psnr
from tests.draws import draws
from tests.model.streets import SOURCES, shifted, street, view
from tests.rasterizer.covers import assert_covers_are

A = Block((0, 0), (0.0, 0.0, 0.0), 40.0, 10.0)
B = Block((1, 0), (30.0, 0.0, 0.0), 40.0, 10.0)
UTM = np.array([441_000.0, 4_475_000.0, 600.0])


def select_latents(appearance: AppearanceLatents) -> tuple[torch.Tensor, torch.Tensor]:
    latent = appearance(SOURCES[0])
    return latent, latent


def far_block(one: Block, by: np.ndarray) -> Block:
    x, y, z = (np.array(one.origin_m) + by).tolist()
    return Block(one.index, (x, y, z), one.size_m, one.overlap_m)


@settings(max_examples=draws(50), deadline=None)
@given(st.integers(0, 2**31), st.integers(1, 9), st.floats(0.0, 40.0))
def test_the_partition_sums_to_one_everywhere(seed: int, count: int, ramp: float) -> None:
    rng = torch.Generator().manual_seed(seed)
    centres = 75.0 * torch.randint(0, 4, (count, 2), generator=rng).double().unique(dim=0)
    places = 1000.0 * (torch.rand(200, 2, generator=rng).double() - 0.5)
    weights = partition(places, centres, ramp)
    assert ((weights >= 0.0) & (weights <= 1.0)).all()
    torch.testing.assert_close(weights.sum(1), torch.ones(200).double())
    order = torch.randperm(len(centres), generator=rng)
    torch.testing.assert_close(partition(places, centres[order], ramp), weights[:, order])


def test_partition_is_one_inside_a_block_and_one_half_midway() -> None:
    centres = torch.tensor([[0.0, 0.0], [75.0, 0.0]]).double()
    places = torch.tensor([[0.0, 500.0], [25.0, 0.0], [37.5, -80.0], [50.0, 0.0]]).double()
    torch.testing.assert_close(partition(places, centres, 25.0)[:, 0], torch.tensor([1.0, 1.0, 0.5, 0.0]).double())


def image(blocks: list[tuple[Block, StreetModel]], x_m: float, by: np.ndarray | float = 0.0) -> np.ndarray:
    here = np.array([x_m, 0.0, 1.5]) + by
    output, _ = Composition(blocks).render(view(*here.tolist()), select_latents)
    return output.rgb.clamp(0.0, 1.0).mul(255.0).round().byte().numpy()


def test_a_single_block_renders_unchanged() -> None:
    one = street()
    output, counts = Composition([(A, one)]).render(view(-15.0), select_latents)
    with torch.no_grad():
        expected = one(to_viewpoint(view(-15.0), np.zeros(3)), select_latents(one.appearance)[0])
    torch.testing.assert_close(output.rgb, expected.rgb, atol=2e-5, rtol=0.0)
    assert counts["nodes_drawn"] == 3 and counts["decoded"] < counts["held"]


def test_covers_are_the_opacity_of_what_lies_before_a_far_plane(monkeypatch: pytest.MonkeyPatch) -> None:
    composition, seen = Composition([(A, street())]), view(-15.0)
    decoded = composition.decode(seen, select_latents)
    output = composition.draw(seen, decoded)
    splats, point = concatenate_splats(decoded.splats), to_viewpoint(seen, decoded.origin_m)
    shape, expected, covers = (point.height_px, point.width_px), [], []
    for limit in (4.0, 12.0, 40.0):
        _, alphas, _ = rasterization(
            splats.means, splats.quats, splats.scales, splats.opacities, splats.colours,
            point.viewmat[None], point.K[None], point.width_px, point.height_px, near_plane=0.2, far_plane=limit,
        )  # fmt: skip
        expected.append(alphas[0, ..., 0])
        covers.append(covered_before(output.meta, np.full(shape, limit, np.float32)))
    assert_covers_are(torch.stack(covers), torch.stack(expected))
    means = torch.stack(covers).mean(dim=(1, 2))
    assert 0.05 < means[0] < means[1] - 0.05 < means[2] <= output.alpha.mean() + 1e-6
    # Each pixel has a limit of its own, or none.
    chosen = np.random.default_rng(0).integers(-1, 3, shape)
    mixed = covered_before(output.meta, np.array([4.0, 12.0, 40.0, 0.0], np.float32)[chosen])
    picked = torch.stack([*covers, torch.zeros(shape)])[torch.from_numpy(chosen), *np.indices(shape)]
    assert torch.equal(mixed, picked)
    for chunk in (1 << 22, 5000):
        monkeypatch.setattr(covers_module, "_CHUNK", chunk)
        with plain_torch():
            plain = covered_before(output.meta, np.array([4.0, 12.0, 40.0, 0.0], np.float32)[chosen])
            none = covered_before(output.meta, np.zeros(shape, np.float32))
        # Less than 1e-4 of the light is left where the kernel stops.
        assert (plain - mixed).abs().max() < 2e-4 and not none.any()


def test_identical_blocks_render_as_one() -> None:
    one = street()
    both = [(A, one), (B, shifted(one, np.array([-30.0, 0.0, 0.0])))]
    # Beyond the strip, only B is rendered; its sky is the only sky.
    assert np.array_equal(image(both, 22.0), image([both[1]], 22.0))
    for x_m in (-15.0, 10.0, 15.0):
        assert psnr(image(both, x_m), image([both[0]], x_m)) > 33.0


def test_renders_are_continuous_across_boundaries() -> None:
    both = [(A, street()), (B, street(seed=5))]
    step = 0.02

    def change(x_m: float) -> float:
        return float(psnr(image(both, x_m - step), image(both, x_m + step)))

    inside = min(change(-5.0), change(38.0))
    for x_m in (10.0, 15.0, 20.0):
        assert change(x_m) > inside - 3.0


def test_sky_structures_inside_a_neighbour_are_dropped() -> None:
    a, b = street(), street(seed=3)
    a.sky.means.data[:20] = torch.tensor((35.0, 0.0, 2.0))  # within B: a wall in front of A's camera
    wall = image([(A, a)], 0.0)
    a_without = street()
    a_without.sky.logits.data[:20] = -20.0
    a_without.sky.means.data[:20] = torch.tensor((35.0, 0.0, 2.0))
    assert np.array_equal(image([(A, a), (B, b)], 0.0), image([(A, a_without), (B, b)], 0.0))
    assert not np.array_equal(wall, image([(A, a_without)], 0.0))


def test_domes_stay_complete_in_a_long_street() -> None:
    row = [Block((place, 0), (75.0 * place, 0.0, 0.0)) for place in range(5)]
    streets = [street(seed=place) for place in range(5)]
    beyond = streets[0].sky.means.data
    beyond[:7] = torch.tensor((230.0, 3.0, 2.0))  # a far structure, within the fourth block
    dome = torch.nn.functional.normalize(beyond[7:], dim=1)
    # Low over the road the dome reaches 300 m, where the fifth block has geometry.
    beyond[7:40] = 300.0 * torch.nn.functional.normalize(
        dome[:33] * torch.tensor((0.0, 0.1, 0.1)) + torch.eye(3)[0], dim=1
    )
    parts = split_street(list(zip(row, streets))).parts
    assert len(parts[0].street.sky) == len(beyond) - 7
    assert len(split_street([(row[0], streets[0])]).parts[0].street.sky) == len(beyond)


def test_a_view_out_of_the_street_is_black() -> None:
    output, counts = Composition([(A, street())]).render(view(5000.0), select_latents)
    assert output.rgb.shape == (54, 96, 3) and output.alpha.shape == output.depth_m.shape == (54, 96)
    assert not output.rgb.any() and not output.alpha.any() and counts["nodes_drawn"] == counts["drawn"] == 0


def test_blocks_that_the_view_does_not_see_are_not_decoded() -> None:
    blocks = [(A, street()), (B, street(seed=3))]
    _, back = Composition(blocks).render(view(200.0), select_latents)
    assert back["nodes_drawn"] == 1  # the sky of B
    _, front = Composition(blocks).render(view(-80.0), select_latents)
    assert front["nodes_drawn"] == 5


def test_utm_sized_origins_give_the_same_image() -> None:
    a, b = street(), street(seed=3)
    near = image([(A, a), (B, b)], 5.0)
    far = image([(far_block(A, UTM), a), (far_block(B, UTM), b)], 5.0, UTM)
    assert psnr(near, far) > 60.0
