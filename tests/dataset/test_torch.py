"""Torch datasets: worker processes, order, sharding and resuming."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from mirror.dataset import Dataset
from mirror.dataset.index import build_index
from mirror.errors import UsageError
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass

torch = pytest.importorskip("torch")
from torch.utils.data import DataLoader  # noqa: E402

from mirror.dataset.torch import FrameDataset, IterableFrames, epoch_order  # noqa: E402

JPEG = cv2.imencode(".jpg", np.full((32, 48, 3), (10, 100, 200), np.uint8))[1].tobytes()
IMAGES = dict.fromkeys(("front_wide", "front_left", "front_right"), JPEG)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    builder = Builder(tmp_path_factory.mktemp("dataset"))
    builder.scene("a")
    dropped = frozenset({("front_left", 2)})
    for number in range(3):
        one = Pass("a", EPOCH + number * 60 * SECOND, frames=9, images=IMAGES, dropped=dropped)
        builder.drive(f"d{number}", [one])
    build_index(builder.root)
    return mirror.open(builder.root)


def keys(batches: list[dict[str, object]]) -> list[tuple[str, int]]:
    return [
        (traversal, int(index))
        for batch in batches
        for traversal, index in zip(batch["traversal_id"], batch["frame_index"])
    ]


def test_a_sample_holds_a_frame(dataset: Dataset) -> None:
    samples = FrameDataset(dataset, ["front_left", "front_wide"])
    assert len(samples) == 27
    item, frame = samples[2], dataset.frames()[2]
    assert item["valid"].tolist() == [False, True]
    assert item["images"].shape == (2, 3, 32, 48) and item["images"].dtype == torch.uint8
    assert np.array_equal(item["images"][1].numpy(), frame.decode(["front_wide"])[0])
    assert not item["images"][0].any() and item["timestamp_ns"].tolist() == [0, frame.timestamp_ns]
    expected = frame.images["front_wide"].world_SE3_camera.matrix()[0]
    assert np.array_equal(item["world_SE3_camera"][1].numpy(), expected)
    assert np.array_equal(item["world_SE3_ego"].numpy(), frame.world_SE3_ego.matrix()[0])
    assert item["intrinsics"][1].tolist() == [[40.0, 0.0, 24.0], [0.0, 40.0, 16.0], [0.0, 0.0, 1.0]]
    assert (item["scene_id"], item["frame_index"]) == ("a", 2)
    assert FrameDataset(dataset).cameras == ("front_wide", "front_left", "front_right")


def test_workers_give_what_one_process_gives(dataset: Dataset) -> None:
    alone = list(IterableFrames(dataset, 4, seed=3))
    spawned = {"batch_size": None, "num_workers": 2, "multiprocessing_context": "spawn"}
    together = list(DataLoader(IterableFrames(dataset, 4, seed=3), **spawned))
    assert keys(together) == keys(alone) and len(set(keys(alone))) == 27
    assert [int(batch["step"]) for batch in together] == list(range(7))
    for one, two in zip(alone, together):
        assert torch.equal(one["images"], two["images"])
        assert torch.equal(one["world_SE3_camera"], two["world_SE3_camera"])


def test_map_style_in_workers_and_resumed_by_a_list(dataset: Dataset) -> None:
    samples = FrameDataset(dataset)
    order = epoch_order(len(samples), seed=1, epoch=2).tolist()
    loader = DataLoader(samples, batch_size=5, sampler=order[10:], num_workers=2, multiprocessing_context="forkserver")
    frames = dataset.frames()
    expected = [(frames[index].traversal_id, frames[index].frame_index) for index in order[10:]]
    assert keys(list(loader)) == expected


def test_resuming_goes_on_exactly_where_it_stopped(dataset: Dataset) -> None:
    whole = list(IterableFrames(dataset, 4, seed=9))
    first = IterableFrames(dataset, 4, seed=9)
    used = [batch for batch, _ in zip(first, range(3))]
    state = first.state_dict(used[-1])
    second = IterableFrames(dataset, 4, seed=9)
    second.load_state_dict(state)
    rest = list(DataLoader(second, batch_size=None))
    assert keys(used) + keys(rest) == keys(whole)
    assert second.state_dict()["step"] == 3 and len(second) == 7
    second.set_epoch(1)
    third = list(second)
    assert keys(third) != keys(whole) and sorted(keys(third)) == sorted(keys(whole))
    assert second.state_dict(third[-1]) == {**state, "epoch": 1, "step": 7}
    for changed in ({"seed": 1}, {"batch_size": 5}, {"world_size": 2}, {"shuffle": False}):
        with pytest.raises(UsageError, match=rf"the state has {next(iter(changed))}"):
            second.load_state_dict({**state, **changed})


def test_a_state_of_another_view_or_index_is_refused(tmp_path: Path) -> None:
    builder = Builder(tmp_path)
    builder.scene("a")
    for number in range(2):
        builder.drive(f"d{number}", [Pass("a", EPOCH + number * 60 * SECOND, frames=9, images=IMAGES)])
    build_index(tmp_path)
    dataset = mirror.open(tmp_path)
    # As many frames, but others.
    one, two = (IterableFrames(dataset.where(drive=drive), 4) for drive in ("d0", "d1"))
    state = json.loads(json.dumps(one.state_dict()))
    with pytest.raises(UsageError, match=r"state has filters .*d0.*d1.*where\(\.\.\.\)"):
        two.load_state_dict(state)
    circled = dataset.where(within=(-79.4, 43.6, 500.0), time=(0, 2**62), drive=["d1", "d0"])
    both = IterableFrames(circled, 4).state_dict()
    IterableFrames(circled, 4).load_state_dict(json.loads(json.dumps(both)))
    with pytest.raises(UsageError, match="state has filters"):
        IterableFrames(dataset, 4).load_state_dict(both)
    builder.drive("d2", [Pass("a", EPOCH + 200 * SECOND, frames=9, images=IMAGES)])
    build_index(tmp_path)
    grown = IterableFrames(mirror.open(tmp_path).where(drive="d0"), 4)
    with pytest.raises(UsageError, match="state has index"):
        grown.load_state_dict(state)
    with pytest.raises(UsageError, match="state has seed None"):
        grown.load_state_dict({"epoch": 0, "step": 1})


@pytest.mark.parametrize("drop_last", [False, True])
def test_ranks_share_the_samples_without_duplicates(dataset: Dataset, drop_last: bool) -> None:
    ranks = [
        list(IterableFrames(dataset, 4, seed=2, rank=rank, world_size=2, drop_last=drop_last)) for rank in range(2)
    ]
    counted = Counter(key for rank in ranks for key in keys(rank))
    assert set(counted.values()) == {1}
    assert len(counted) == (24 if drop_last else 27)
    assert [len(rank) for rank in ranks] == ([3, 3] if drop_last else [4, 4])
    parts = [IterableFrames(dataset, 4, rank=rank, world_size=2, drop_last=drop_last) for rank in range(2)]
    assert [len(part) for part in parts] == [len(rank) for rank in ranks]


def test_without_shuffling_frames_come_in_order(dataset: Dataset) -> None:
    expected = [(frame.traversal_id, frame.frame_index) for frame in dataset.frames()]
    assert keys(list(IterableFrames(dataset, 5, shuffle=False))) == expected


def test_orders_are_permutations_that_seed_and_epoch_fix() -> None:
    for count in (0, 1, 2, 1000):
        assert sorted(epoch_order(count, 5, 6).tolist()) == list(range(count))
    orders = {tuple(epoch_order(50, seed, epoch).tolist()) for seed in (0, 1, -1, 2**70) for epoch in range(3)}
    # 2**70 and 0 are the same seed of 64 bits.
    assert len(orders) == 9
    # Pinned: a saved state must mean the same order in every later release.
    assert epoch_order(8, 1, 2).tolist() == [1, 3, 7, 2, 6, 4, 5, 0]
    places = np.stack([epoch_order(10, 0, epoch) for epoch in range(2000)])
    counts = np.stack([np.bincount(column, minlength=10) for column in places.T])
    assert np.abs(counts - 200).max() < 6 * np.sqrt(200)


def test_what_makes_no_dataset_is_refused(dataset: Dataset) -> None:
    with pytest.raises(UsageError, match="no camera 'rear'"):
        FrameDataset(dataset, ["rear"])
    with pytest.raises(UsageError, match="no images"):
        FrameDataset(dataset.where(drive="d0").where(drive="d1"))
    for batch_size, rank in ((0, 0), (1, 2), (1, -1)):
        with pytest.raises(UsageError, match="world_size"):
            IterableFrames(dataset, batch_size, rank=rank, world_size=2)
