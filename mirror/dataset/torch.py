"""Torch datasets of frames: map-style and iterable, safe in worker processes, resumable at any sample.

The order of an epoch is a pure function of seed and epoch. A worker receives only the dataset's path and the view's
restrictions and opens the dataset itself. Workers must be started with ``spawn`` or ``forkserver``. A forked worker is
refused: it inherits locks of threads that it does not have, and may wait for them for ever.
"""

from __future__ import annotations

import hashlib
import multiprocessing
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, Final, TypedDict, Unpack

import numpy as np
from torch.utils.data import Dataset as TorchDataset
from torch.utils.data import IterableDataset, default_collate, get_worker_info

from mirror.arrays import Int64
from mirror.dataset.contents import ImageLayout, raster_shapes, resolve_contents
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame, FrameSequence
from mirror.dataset.raster import Resize
from mirror.dataset.samples import LENS_MODELS, Sample, camera_of, make_sample
from mirror.errors import UsageError

__all__ = ["LENS_MODELS", "FrameDataset", "IterableFrames", "Sample", "SampleOptions", "camera_of", "epoch_order"]

_REMEDIES: Final = {
    "index": "restore the dataset of the state, or start a new epoch with set_epoch",
    "filters": "make the view with the same where(...), or start a new epoch with set_epoch",
    "groups": "make the dataset with the same cameras, undistort and resize, or start a new epoch with set_epoch",
}


class SampleOptions(TypedDict, total=False):
    """Options of `FrameDataset`; see there."""

    undistort: bool
    resize: Resize | None
    layout: ImageLayout
    boxes: bool
    categories: Sequence[str] | None
    masks: Sequence[str] | None
    verify: bool


class FrameDataset(TorchDataset[Sample]):
    """The frames of a view as a map-style dataset.

    A sample is a dictionary that torch's own collate function accepts. It has C cameras in a fixed order, images of at
    most H x W pixels and at most N boxes:

    - ``images`` (C, 3, H, W) uint8, RGB. A smaller image fills the upper left corner, so its intrinsics stay valid; the
      rest is zero. ``height_px``, ``width_px`` (C,): its size. ``valid`` (C,) bool: False where a camera has no image
      in this frame, or a published dataset withholds it; its part of the sample is then zero. The view
      ``dataset.where(withheld=False)`` has no frame with a withheld image. ``pixel_valid`` (C, H, W) bool: True where a
      pixel is computed from recorded pixels. It is False beyond a smaller image, and where an undistorted image extends
      beyond the lens.
    - ``intrinsics`` (C, 3, 3) float64: the matrix K of the images in the sample; the first pixel's centre is at 0.5.
      ``lens`` (C,): number of the camera model in `LENS_MODELS`, -1 without an image. K describes the complete lens
      only for a ``pinhole``. ``distortion`` (C, 16) float64: the model's coefficients, then zeros;
      ``distortion_count`` (C,): their number. `camera_of` makes a `mirror.geometry.Camera` from these values.
    - ``world_SE3_camera`` (C, 4, 4) at each image's mid-exposure, ``world_SE3_ego`` (4, 4) at the frame's time,
      float64, in metres.
    - ``timestamp_ns``, ``exposure_start_ns``, ``exposure_end_ns`` (C,) int64; ``frame_timestamp_ns``.
    - ``scene_id``, ``traversal_id``, ``frame_index``.
    - ``masks``: by name (C, H, W) bool, True for pixels of that kind; ``instance`` (C, H, W) uint8, as stored.
      ``mask_valid``: by name (C,) bool, False where an image has no such mask; the mask is then False everywhere and
      has no meaning.
    - ``world_SE3_box`` (N, 4, 4), ``box_size_m`` (N, 3) length, width, height, ``box_velocity_mps`` (N, 3) over ground
      along the world's axes, NaN where unknown; ``box_category`` (N,): number in ``categories``; ``box_track`` (N,):
      number of the object within its traversal, in `Frame.track_ids`; ``box_score`` (N,), NaN for a label without one;
      ``box_valid`` (N,) bool: False in the rows after the last box. ``box_timestamp_ns``: the time of the boxes.

    For a resumable shuffled order, pass ``sampler=epoch_order(len(dataset), seed, epoch)[consumed:]`` to the loader.

    Args:
        dataset: the view.
        cameras: cameras of every sample, in this order; default: all of the view. With a single name, samples hold that
            camera only, and their tensors have no camera axis.
        undistort: map images and masks to the pinhole of `mirror.geometry.undistorted`, which the benchmark's protocols
            use; ``lens`` and ``intrinsics`` are then those of the pinhole.
        resize: (height, width) for all images, or a factor such as 0.5; ``intrinsics`` are scaled accordingly.
        layout: ``chw``, or ``hwc``: ``images`` is (C, H, W, 3).
        boxes: whether samples have boxes; they come from the box layer of the view.
        categories: keep only boxes of these categories, numbered in this order; default: all of the dataset, sorted.
        masks: a list of ``kind`` or ``kind/source@version``; default: every kind in the dataset. For ``ego``, the mask
            of the rig is used where an image has no such mask.
        verify: compare every image with its hash.

    Attributes:
        dataset: the view.
        cameras: names along the camera axis.
        categories: categories of boxes, by number.
        masks: names of the masks.

    Raises:
        UsageError: the view has no images, or an argument does not fit it.
    """

    def __init__(
        self,
        dataset: Dataset,
        cameras: str | Sequence[str] | None = None,
        *,
        undistort: bool = False,
        resize: Resize | None = None,
        layout: ImageLayout = "chw",
        boxes: bool = True,
        categories: Sequence[str] | None = None,
        masks: Sequence[str] | None = None,
        verify: bool = False,
    ) -> None:
        self.dataset = dataset
        self._contents = resolve_contents(
            dataset,
            cameras,
            undistort=undistort,
            resize=resize,
            layout=layout,
            boxes=boxes,
            categories=categories,
            masks=masks,
            verify=verify,
        )
        self.cameras = self._contents.cameras
        self.categories = self._contents.categories
        self.masks = self._contents.masks
        self._shapes = raster_shapes(dataset, self._contents)
        self._frames: FrameSequence | None = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_frames": None}

    @property
    def frames(self) -> FrameSequence:
        """The frames; each process selects them on first use.

        Raises:
            UsageError: this is a forked worker process of a loader.
        """
        if get_worker_info() is not None and is_forked():
            raise UsageError(
                "this worker process was forked, and may wait for ever for threads that it does not have",
                expected="workers that are spawned",
                remedy='DataLoader(..., multiprocessing_context="spawn"), or "forkserver"',
            )
        if self._frames is None:
            self._frames = self.dataset.frames()
        return self._frames

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width (H, W) that fit every image."""
        heights, widths = zip(*self._shapes.values())
        return max(heights), max(widths)

    def _shape_of(self, traversal_id: str) -> tuple[int, int]:
        return self._shapes.get(traversal_id, self.shape)

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, index: int) -> Sample:
        return self._make_batch([index])[0]

    def __getitems__(self, indices: Sequence[int]) -> list[Sample]:
        """The samples of a batch, which torch's loaders ask for; their images are read together.

        A subclass with a `__getitem__` of its own gets its own samples, one after the other.
        """
        is_plain = type(self).__getitem__ is FrameDataset.__getitem__
        return self._make_batch(indices) if is_plain else [self[index] for index in indices]

    def _make_batch(self, indices: Sequence[int]) -> list[Sample]:
        return [self.make(frame) for frames in self.read_ahead([indices]) for frame in frames]

    def read_ahead(self, groups: Iterable[Sequence[int] | Int64]) -> Iterator[list[Frame]]:
        """Yield the frames of groups of indices, while the images of the next groups are being read."""
        plain = ([int(index) for index in group] for group in groups)
        return self.frames.read_ahead(plain, self.cameras, masks=bool(self.masks))

    def unpadded(self, index: int) -> Sample:
        """Make the sample of a frame with image tensors as large as the largest image of its traversal."""
        return self.make(self.frames[int(index)], padded=False)

    def make(self, frame: Frame, *, padded: bool = True) -> Sample:
        """Make the sample of a frame.

        Args:
            frame: the frame.
            padded: image tensors as large as the largest image of the view; False: of the frame's traversal.
        """
        return make_sample(frame, self._contents, self.shape if padded else self._shape_of(frame.traversal_id))

    def shapes(self) -> Int64:
        """Return the height and width (F, 2) of the image tensors that `unpadded` makes for each of F frames."""
        parts = self.frames.parts
        traversals = self.dataset.catalog.traversal_ids
        of_parts = [self._shape_of(traversals[part.traversal].as_py()) for part in parts]
        return np.repeat(np.array(of_parts, np.int64).reshape(-1, 2), [part.rows for part in parts], axis=0)


class IterableFrames(IterableDataset[Sample]):
    """The frames of a view as batches, in a resumable order that is shuffled in every epoch.

    It makes the batches itself: pass ``batch_size=None`` and any number of workers to the loader. The batches and their
    order do not depend on the number of workers. A batch is a dictionary of collated samples with ``epoch`` and the
    batch number ``step``.

    To resume, save ``state_dict(batch)`` of the last batch that was used, and load it before iterating again. Workers
    copy epoch and state when they start, so do not keep them over epochs (``persistent_workers``).

    Args:
        dataset: the view.
        batch_size: samples a batch; the last one of an epoch, or of a size, may be smaller.
        cameras: as in `FrameDataset`.
        seed: random seed of the order.
        shuffle: False: frames come in order of traversal and time.
        rank: number of this process's share of the samples.
        world_size: number of shares; no sample is in two shares.
        drop_last: leave out frames that do not fill a batch of every rank, so that all ranks have the same number of
            batches.
        group_by_size: put frames with image tensors of the same size into a batch. Without it, all tensors of the view
            are as large as its largest image.
        options: options of `FrameDataset`.

    Raises:
        UsageError: the view has no images, an argument does not fit it, or a number is out of range.
    """

    def __init__(
        self,
        dataset: Dataset,
        batch_size: int,
        cameras: str | Sequence[str] | None = None,
        *,
        seed: int = 0,
        shuffle: bool = True,
        rank: int = 0,
        world_size: int = 1,
        drop_last: bool = False,
        group_by_size: bool = False,
        **options: Unpack[SampleOptions],
    ) -> None:
        if batch_size < 1 or not 0 <= rank < world_size:
            raise UsageError(
                f"batch_size {batch_size}, rank {rank} of world_size {world_size}",
                expected="batch_size >= 1 and 0 <= rank < world_size",
            )
        self._samples = FrameDataset(dataset, cameras, **options)
        self._batch_size = batch_size
        self._seed = seed
        self._shuffle = shuffle
        self._rank = rank
        self._world_size = world_size
        self._drop_last = drop_last
        self._group_by_size = group_by_size
        self._epoch = 0
        self._step = 0

    @property
    def samples(self) -> FrameDataset:
        """The samples that the batches are made of, with the names of cameras, categories and masks."""
        return self._samples

    @property
    def cameras(self) -> tuple[str, ...]:
        """Cameras of every sample, in order."""
        return self._samples.cameras

    def set_epoch(self, epoch: int) -> None:
        """Start an epoch at its first batch."""
        self._epoch = epoch
        self._step = 0

    def __len__(self) -> int:
        """Number of batches of this rank in an epoch."""
        frames_a_step = self._batch_size * self._world_size
        full, rest = np.divmod(np.array([len(group) for group in self._groups()], np.int64), frames_a_step)
        return int(full.sum() + (0 if self._drop_last else np.count_nonzero(rest > self._rank)))

    def __iter__(self) -> Iterator[Sample]:
        """Yield the batches from the current state to the end of the epoch; one of n workers yields every n-th."""
        worker = get_worker_info()
        number, workers = (0, 1) if worker is None else (worker.id, worker.num_workers)
        batches = self._batches()
        # Worker w takes every n-th batch from the first remaining one. A loader takes a batch from each worker in turn,
        # so batches come in order, and the used ones are always the first of the epoch.
        steps = range(self._step + number, len(batches), workers)
        frames = self._samples.read_ahead(batches[step] for step in steps)
        for step, batch in zip(steps, frames):
            yield {**default_collate(self._load(batch)), "epoch": self._epoch, "step": step}

    def state_dict(self, batch: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return the state that, when loaded, continues after a batch.

        Args:
            batch: the last batch that was used; None: the state that was loaded or set.
        """
        epoch, step = (self._epoch, self._step) if batch is None else (int(batch["epoch"]), int(batch["step"]) + 1)
        return {
            "seed": self._seed,
            "epoch": epoch,
            "step": step,
            "batch_size": self._batch_size,
            "world_size": self._world_size,
            "shuffle": self._shuffle,
            "drop_last": self._drop_last,
            "group_by_size": self._group_by_size,
            "groups": self._groups_sha256,
            "index": self._samples.dataset.index_sha256,
            "filters": self._samples.dataset.filters.to_dict(),
        }

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Continue from a state of `state_dict`.

        Raises:
            UsageError: the state has another seed, batch size, number of ranks, index or view, or other frames share a
                batch, so its order differs.
        """
        ours = self.state_dict()
        # The oldest version had no groups; later ones had drop_last and groups, but did not state them.
        state = {"group_by_size": False, "drop_last": self._drop_last, "groups": self._groups_sha256, **state}
        for name in [name for name in ours if name not in ("epoch", "step")]:
            theirs = state.get(name)
            if theirs != ours[name]:
                raise UsageError(
                    f"the state has {name} {theirs!s:.200}, this dataset {ours[name]!s:.200}",
                    place=f"state_dict[{name!r}]",
                    expected="the state of a dataset made in the same way",
                    remedy=_REMEDIES.get(name, f"make the dataset with {name}={theirs}"),
                )
        self._epoch = state["epoch"]
        self._step = state["step"]

    def _load(self, frames: Sequence[Frame]) -> list[Sample]:
        return [self._samples.make(frame, padded=not self._group_by_size) for frame in frames]

    def _group_numbers(self) -> Int64:
        """The number (F,) of the group of each of F frames; frames of one group may share a batch."""
        if not self._group_by_size:
            return np.zeros(len(self._samples), np.int64)
        return np.unique(self._samples.shapes(), axis=0, return_inverse=True)[1].reshape(-1)

    def _groups(self) -> list[Int64]:
        """The frames of each group, in ascending order."""
        numbers = self._group_numbers()
        return [np.flatnonzero(numbers == number) for number in range(numbers.max(initial=-1) + 1)]

    @cached_property
    def _groups_sha256(self) -> str | None:
        if not self._group_by_size:
            return None
        return hashlib.sha256(self._group_numbers().astype("<i8").tobytes()).hexdigest()

    def _batches(self) -> list[Int64]:
        """The frame numbers of this rank's batches in the epoch; a batch holds frames of one group.

        In each step, the batches of all ranks come from the same section of a group, so they have the same size. Steps
        are ordered by their first frames.
        """
        total = len(self._samples)
        order = epoch_order(total, self._seed, self._epoch) if self._shuffle else np.arange(total)
        position = np.empty(total, np.int64)
        position[order] = np.arange(total)
        frames_a_step = self._batch_size * self._world_size
        batches: list[tuple[int, Int64]] = []
        for group in self._groups():
            positions = np.sort(position[group])
            for start in range(0, len(positions), frames_a_step):
                section = positions[start : start + frames_a_step]
                frames = order[section[self._rank :: self._world_size]]
                if len(frames) and (len(section) == frames_a_step or not self._drop_last):
                    batches.append((int(section[0]), frames))
        return [frames for _, frames in sorted(batches, key=lambda batch: batch[0])]


def epoch_order(count: int, seed: int, epoch: int) -> Int64:
    """Return a permutation (count,) of 0 .. count - 1 that depends only on seed and epoch.

    Samples are sorted by a hash of seed, epoch and index: the finaliser of SplitMix64 (Steele et al. 2014). So no
    version of a library changes the order.
    """
    # With a one-element array, numpy keeps the type and wraps without a warning.
    key = _mix(_mix(np.array([seed % 2**64], np.uint64)) + np.array([epoch % 2**64], np.uint64))
    return np.argsort(_mix(key + np.arange(count, dtype=np.uint64)), kind="stable")


def is_forked() -> bool:
    """Return whether this process was started by a fork."""
    if "fork" not in multiprocessing.get_all_start_methods():
        return False
    process = multiprocessing.current_process()
    by_default = type(process) is multiprocessing.Process and multiprocessing.get_start_method() == "fork"
    return by_default or isinstance(process, multiprocessing.get_context("fork").Process)


def _mix(values: Any) -> Any:
    """The finaliser of SplitMix64."""
    values = values + np.uint64(0x9E3779B97F4A7C15)
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return values ^ (values >> np.uint64(31))
