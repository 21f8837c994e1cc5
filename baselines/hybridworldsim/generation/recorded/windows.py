"""The windows of a traversal: consecutive frames at a rate in which the vehicle moves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from hybridworldsim.generation.scenes.plan import choose_stride
from mirror.arrays import AnyArray, Bool, Float64, Int64
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.geometry.interpolation import interpolate

MASK_KINDS: Final = ("dynamic", "instance")
"""Kinds of masks whose non-zero pixels show road users."""
_EVEN: Final = 0.2
"""Steps of a window differ from the period by no more than this share of it; else frames were lost between."""


@dataclass(frozen=True)
class WindowOptions:
    """Options that choose the windows of traversals.

    Attributes:
        frames: frames of a window.
        hz: frames per second; None: 5, or the rate of a slower recording.
        least_move_m: the vehicle drives at least so far in a window.
        may_lack: largest share of the images of a window that are missing or have no mask; None: not stated.
    """

    frames: int = 26
    hz: float | None = None
    least_move_m: float = 3.0
    may_lack: float | None = None

    def __post_init__(self) -> None:
        if self.frames < 2:
            raise UsageError(f"{self.frames} frames", place="--frames", expected="at least 2")
        if self.hz is not None and not (np.isfinite(self.hz) and self.hz > 0.0):
            raise UsageError(f"{self.hz} frames per second", place="--hz", expected="a finite rate above 0")
        if not (np.isfinite(self.least_move_m) and self.least_move_m >= 0.0):
            raise UsageError(f"{self.least_move_m} m", place="--min-move", expected="a finite distance, 0 or more")
        if self.may_lack is not None and not 0.0 <= self.may_lack < 1.0:
            raise UsageError(f"{self.may_lack}", place="--may-lack", expected="a share from 0 to below 1")


@dataclass(frozen=True)
class TraversalWindows:
    """The windows of a traversal.

    Attributes:
        traversal_id: the traversal.
        scene_id: its scene.
        rate_hz: frames per second.
        stride: every how many recorded frames one is used.
        firsts: positions of the first frames of the windows among the frames of the traversal.
        candidates: windows of consecutive frames, standing ones included.
        standing: candidates in which the vehicle moves less than asked for.
        lacking: shares of missing images or masks of the windows, before those that lack too much are left out.
    """

    traversal_id: str
    scene_id: str
    rate_hz: float
    stride: int
    firsts: tuple[int, ...]
    candidates: int
    standing: int
    lacking: tuple[float, ...]

    @property
    def left_out(self) -> int:
        """Number of windows that lack too many images or masks."""
        return len(self.lacking) - len(self.firsts)


def plan_windows(
    dataset: Dataset, traversal_id: str, cameras: tuple[str, ...], options: WindowOptions
) -> TraversalWindows:
    """Plan the windows of a traversal; no image is opened.

    Args:
        dataset: the dataset.
        traversal_id: the traversal.
        cameras: cameras of the clips.
        options: see `WindowOptions`. With `may_lack` None no window is left out.

    Raises:
        UsageError: the rate is above that of the recording.
    """
    view = dataset.where(traversal=traversal_id)
    rows = view.table("frames", ["frame_index", "timestamp_ns", "scene_id"])
    index, stamps = (rows.column(name).to_numpy() for name in ("frame_index", "timestamp_ns"))
    scene_id = rows.column("scene_id")[0].as_py() if len(stamps) else ""
    if len(stamps) < options.frames:
        return TraversalWindows(traversal_id, scene_id, 0.0, 1, (), 0, 0, ())
    stride, recorded_hz = choose_stride(stamps, options.hz)
    rate_hz = recorded_hz / stride
    chosen = np.arange(0, len(stamps), stride)
    driven_m = _driven_m(view, stamps[chosen])
    complete = _complete(view, index[chosen], cameras)
    windows = [
        slice(begin, begin + options.frames)
        for first, last in _stretches(stamps[chosen], rate_hz)
        for begin in range(first, last - options.frames + 1, options.frames)
    ]
    moving = [one for one in windows if driven_m[one.stop - 1] - driven_m[one.start] >= options.least_move_m]
    lacking = [float(1.0 - complete[one].mean()) for one in moving]
    most = 1.0 if options.may_lack is None else options.may_lack
    return TraversalWindows(
        traversal_id,
        scene_id,
        rate_hz,
        stride,
        tuple(int(chosen[one.start]) for one, lack in zip(moving, lacking) if lack <= most),
        len(windows),
        len(windows) - len(moving),
        tuple(lacking),
    )


def require_bounds(planned: list[TraversalWindows], options: WindowOptions) -> None:
    """Require a stated bound on what windows may lack, if some lack anything, and at least one remaining window.

    Raises:
        UsageError: windows lack images or masks and `may_lack` is not stated, or no window is left.
    """
    lacking = [share for one in planned for share in one.lacking]
    some = [share for share in lacking if share > 0.0]
    if some and options.may_lack is None:
        name = next(one.traversal_id for one in planned if any(share > 0.0 for share in one.lacking))
        raise UsageError(
            f"{len(some)} of {len(lacking)} windows lack images or masks, up to {max(some):.1%} of theirs",
            place=f"--may-lack, first in {name}", expected="the largest share that a window may lack",
            remedy=f"--may-lack 0 leaves these windows out, --may-lack {_rounded_up(max(some)):g} keeps them all",
        )  # fmt: skip
    if not any(one.firsts for one in planned):
        candidates, standing, left_out = (
            sum(getattr(one, name) for one in planned) for name in ("candidates", "standing", "left_out")
        )
        raise UsageError(
            f"no window is left of {candidates}: {standing} stand, {left_out} lack too much",
            expected=f"{options.frames} consecutive frames in which the vehicle moves {options.least_move_m:g} m",
            remedy="lower --frames or --min-move, or raise --may-lack",
        )  # fmt: skip


def _rounded_up(share: float) -> float:
    return min(np.ceil(share * 100.0) / 100.0, 0.99)


def _stretches(stamps: Int64, rate_hz: float) -> Iterator[tuple[int, int]]:
    """First and last position (exclusive) of each stretch without a lost frame."""
    even = np.abs(np.diff(stamps) * 1e-9 * rate_hz - 1.0) <= _EVEN
    breaks = [0, *(np.flatnonzero(~even) + 1).tolist(), len(stamps)]
    return pairwise(breaks)


def _driven_m(view: Dataset, stamps: Int64) -> Float64:
    """Path length (N,) from the first to each time."""
    places_m = interpolate(*view.frames()[0].track, stamps).translation
    steps_m = np.linalg.norm(np.diff(places_m, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps_m)])


def _complete(view: Dataset, frame_index: Int64, cameras: tuple[str, ...]) -> Bool:
    """Mark the images (F, V) that exist and have a mask of road users.

    A layer of masks without a row has found no road user, so that no image lacks one.
    """
    images = view.table("images", ["frame_index", "camera", "timestamp_ns"]).to_pydict()
    masks = view.table("masks", ["camera", "timestamp_ns", "kind"]).to_pydict()
    masked = {
        (camera, stamp)
        for camera, stamp, kind in zip(masks["camera"], masks["timestamp_ns"], masks["kind"])
        if kind in MASK_KINDS
    }
    places: AnyArray = np.full((int(frame_index.max()) + 1, len(cameras)), False)
    columns = {camera: column for column, camera in enumerate(cameras)}
    for index, camera, stamp in zip(images["frame_index"], images["camera"], images["timestamp_ns"]):
        if camera in columns and index is not None and index < len(places):
            places[index, columns[camera]] = not masked or (camera, stamp) in masked
    return np.asarray(places[frame_index])
