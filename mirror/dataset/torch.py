"""Torch datasets of frames: map-style and iterable, safe in worker processes, resumable to the sample.

The order of an epoch is a pure function of seed and epoch. Only the dataset's path and the view's restrictions travel
to a worker; it opens the dataset itself. Worker processes are to be started with ``spawn`` or ``forkserver``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
import torch
from torch.utils.data import Dataset as TorchDataset
from torch.utils.data import IterableDataset, default_collate, get_worker_info

from mirror.arrays import Int64
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame, FrameSequence
from mirror.dataset.query.arrow import numbers
from mirror.errors import UsageError

Sample = dict[str, Any]

_MAKE_AGAIN: Final = {
    "index": "restore the dataset as it was, or begin a new epoch with set_epoch",
    "filters": "make the view with the same where(...), or begin a new epoch with set_epoch",
}


class FrameDataset(TorchDataset[Sample]):
    """The frames of a view as a map-style dataset; see `sample` for what an item is.

    For a resumable shuffled order give a loader ``sampler=epoch_order(len(dataset), seed, epoch)[consumed:]``.

    Args:
        dataset: the view.
        cameras: cameras of every sample, in this order; default: all of the view.
        verify: hold every picture against its hash.

    Raises:
        UsageError: the view has no pictures, a camera is not in it, or their pictures are of several sizes.
    """

    def __init__(self, dataset: Dataset, cameras: Sequence[str] | None = None, *, verify: bool = False) -> None:
        self.dataset = dataset
        self.cameras = _cameras(dataset, cameras)
        self.verify = verify
        self._size = _size(dataset.where(camera=self.cameras))
        self._frames: FrameSequence | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_frames": None}

    @property
    def frames(self) -> FrameSequence:
        """The frames, found on first use in each process."""
        if self._frames is None:
            self._frames = self.dataset.frames()
        return self._frames

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> Sample:
        return sample(self.frames[int(index)], self.cameras, self._size, verify=self.verify)


class IterableFrames(IterableDataset[Sample]):
    """The frames of a view as batches, in an order that is shuffled anew each epoch, and resumable.

    It makes the batches itself: give a loader ``batch_size=None`` and any number of workers; the batches and their
    order do not depend on that number. A batch is a collated sample with ``epoch`` and its number ``step``.

    To resume, save ``state_dict(batch)`` of the last batch that was used, and load it before iterating again. Workers
    take epoch and state over when they start: do not keep them over epochs (``persistent_workers``).

    Args:
        dataset: the view.
        batch_size: samples a batch; the last one of an epoch may be smaller.
        cameras: cameras of every sample, in this order; default: all of the view.
        seed: what the order is drawn by.
        shuffle: False: in order of traversal and time.
        rank: which share of the samples is this process's.
        world_size: number of shares; they have no sample in common.
        drop_last: leave out what does not fill a batch of every rank, so that all ranks have as many.
        verify: hold every picture against its hash.

    Raises:
        UsageError: the view has no pictures, a camera is not in it, or a number is out of range.
    """

    def __init__(
        self,
        dataset: Dataset,
        batch_size: int,
        cameras: Sequence[str] | None = None,
        *,
        seed: int = 0,
        shuffle: bool = True,
        rank: int = 0,
        world_size: int = 1,
        drop_last: bool = False,
        verify: bool = False,
    ) -> None:
        if batch_size < 1 or not 0 <= rank < world_size:
            raise UsageError(
                f"batch_size {batch_size}, rank {rank} of world_size {world_size}",
                expected="batch_size >= 1 and 0 <= rank < world_size",
            )
        self._samples = FrameDataset(dataset, cameras, verify=verify)
        self._batch_size = batch_size
        self._seed = seed
        self._shuffle = shuffle
        self._rank = rank
        self._world_size = world_size
        self._drop_last = drop_last
        self._epoch = 0
        self._step = 0

    @property
    def cameras(self) -> tuple[str, ...]:
        """Cameras of every sample, in order."""
        return self._samples.cameras

    def set_epoch(self, epoch: int) -> None:
        """Begin an epoch at its first batch."""
        self._epoch = epoch
        self._step = 0

    def __len__(self) -> int:
        """Batches in a whole epoch."""
        return -(-self._own_count() // self._batch_size)

    def __iter__(self) -> Iterator[Sample]:
        """Batches from where the state stands to the end of the epoch; with workers, every n-th of them."""
        worker = get_worker_info()
        number, workers = (0, 1) if worker is None else (worker.id, worker.num_workers)
        total = len(self._samples)
        order = epoch_order(total, self._seed, self._epoch) if self._shuffle else np.arange(total)
        own = order[self._rank :: self._world_size][: self._own_count()]
        # Worker w takes every n-th batch from the first to do: a loader asks its workers in turn, so that batches come
        # in order, and those that were used are always the first ones of the epoch.
        for step in range(self._step + number, len(self), workers):
            start = step * self._batch_size
            collated = default_collate([self._samples[int(index)] for index in own[start : start + self._batch_size]])
            yield {**collated, "epoch": self._epoch, "step": step}

    def state_dict(self, batch: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """What to load to go on behind a batch.

        Args:
            batch: the last batch that was used; None: the state as it was loaded or set.
        """
        epoch, step = (self._epoch, self._step) if batch is None else (int(batch["epoch"]), int(batch["step"]) + 1)
        return {
            "seed": self._seed,
            "epoch": epoch,
            "step": step,
            "batch_size": self._batch_size,
            "world_size": self._world_size,
            "shuffle": self._shuffle,
            "index": self._samples.dataset.index_sha256,
            "filters": self._samples.dataset.filters.to_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Go on from a state.

        Raises:
            UsageError: it is of another seed, batch size, number of ranks, index or view: the order differs.
        """
        ours = self.state_dict()
        for name in ("seed", "batch_size", "world_size", "shuffle", "index", "filters"):
            theirs = state.get(name)
            if theirs != ours[name]:
                raise UsageError(
                    f"the state has {name} {theirs!s:.200}, this dataset {ours[name]!s:.200}",
                    place=f"state_dict[{name!r}]",
                    expected="the state of a dataset made in the same way",
                    remedy=_MAKE_AGAIN.get(name, f"make the dataset with {name}={theirs}"),
                )
        self._epoch = state["epoch"]
        self._step = state["step"]

    def _own_count(self) -> int:
        total = len(self._samples)
        if self._drop_last:
            return total // (self._world_size * self._batch_size) * self._batch_size
        return len(range(self._rank, total, self._world_size))


def epoch_order(count: int, seed: int, epoch: int) -> Int64:
    """A permutation (count,) of 0 .. count - 1 that depends on seed and epoch alone.

    Samples are sorted by a hash of seed, epoch and index (the finaliser of SplitMix64, Steele et al. 2014), which no
    release of a library changes.
    """
    # A list of one makes numpy keep the type and wrap without a warning.
    key = _mix(_mix(np.array([seed % 2**64], np.uint64)) + np.array([epoch % 2**64], np.uint64))
    return np.argsort(_mix(key + np.arange(count, dtype=np.uint64)), kind="stable")


def sample(frame: Frame, cameras: Sequence[str], size: tuple[int, int], *, verify: bool = False) -> Sample:
    """One frame as tensors that collate; a camera without a picture is zero there and False in ``valid``.

    ``images`` (C, 3, H, W) uint8, ``valid`` (C,) bool, ``timestamp_ns`` (C,) int64, ``intrinsics`` (C, 3, 3) float64
    with the first pixel's centre at 0.5, ``world_SE3_camera`` (C, 4, 4) and ``world_SE3_ego`` (4, 4) float64, and the
    keys ``scene_id``, ``traversal_id``, ``frame_index``, ``frame_timestamp_ns``.

    Args:
        frame: the frame.
        cameras: cameras of the sample, in order.
        size: height and width of every picture.
        verify: hold every picture against its hash.

    Raises:
        DatasetError: a picture, pose or calibration is missing or broken.
    """
    count = len(cameras)
    images = np.zeros((count, 3, *size), np.uint8)
    valid, stamps = np.zeros(count, np.bool_), np.zeros(count, np.int64)
    intrinsics, mounted = np.zeros((count, 3, 3)), np.zeros((count, 4, 4))
    for row, camera in enumerate(cameras):
        image = frame.images.get(camera)
        if image is not None:
            valid[row], stamps[row] = True, image.timestamp_ns
            intrinsics[row] = image.camera_model.intrinsic_matrix()
            mounted[row] = image.world_SE3_camera.matrix()[0]
    # A worker is one of many: it keeps to its own thread.
    frame.decode_into(images, cameras, threads=None if get_worker_info() is None else 1, verify=verify)
    return {
        "images": torch.from_numpy(images),
        "valid": torch.from_numpy(valid),
        "timestamp_ns": torch.from_numpy(stamps),
        "intrinsics": torch.from_numpy(intrinsics),
        "world_SE3_camera": torch.from_numpy(mounted),
        "world_SE3_ego": torch.from_numpy(frame.world_SE3_ego.matrix()[0]),
        "scene_id": frame.scene_id,
        "traversal_id": frame.traversal_id,
        "frame_index": frame.frame_index,
        "frame_timestamp_ns": frame.timestamp_ns,
    }


def _size(view: Dataset) -> tuple[int, int]:
    rasters = view.table("images", ["height_px", "width_px"])
    heights, widths = (np.unique(numbers(column)).tolist() for column in rasters.columns)
    if len(heights) > 1 or len(widths) > 1:
        raise UsageError(
            f"pictures of several sizes: heights {heights}, widths {widths}",
            remedy="choose cameras or drives of one size: where(camera=..., drive=...)",
        )
    return heights[0], widths[0]


def _cameras(dataset: Dataset, cameras: Sequence[str] | None) -> tuple[str, ...]:
    known = dataset.cameras()
    if not known:
        raise UsageError("the view has no pictures", remedy="choose scenes or drives that were recorded with cameras")
    for camera in cameras or ():
        if camera not in known:
            raise UsageError(f"no camera {camera!r} in the view", expected=f"of {', '.join(known)}")
    return tuple(known if cameras is None else cameras)


def _mix(values: Any) -> Any:
    values = values + np.uint64(0x9E3779B97F4A7C15)
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return values ^ (values >> np.uint64(31))
