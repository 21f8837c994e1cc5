"""Edits of a clip's boxes: move, remove, add. Images and backgrounds stay as they are."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np

from hybridworldsim.generation.clips.clip import CATEGORIES, Clip, ClipBoxes
from mirror.arrays import Float64
from mirror.errors import UsageError


def move_track(clip: Clip, track: int, *, dx: float = 0.0, dy: float = 0.0) -> Clip:
    """Move a road user in all frames.

    Args:
        clip: the clip.
        track: its number.
        dx: metres forward, along the box's own length.
        dy: metres to the left, along the box's own width.

    Raises:
        UsageError: no box has this track, or a distance is not finite.
    """
    rows = _rows(clip, track)
    if not np.isfinite([dx, dy]).all():
        raise UsageError(f"a move by {dx}, {dy} m", expected="finite distances")
    poses = clip.boxes.ego_SE3_box.copy()
    poses[rows, :3, 3] += poses[rows][:, :3, :3] @ np.array([dx, dy, 0.0])
    return replace(clip, boxes=replace(clip.boxes, ego_SE3_box=poses))


def remove_track(clip: Clip, track: int) -> Clip:
    """Remove a road user from all frames.

    Raises:
        UsageError: no box has this track.
    """
    rows = _rows(clip, track)
    return replace(clip, boxes=clip.boxes[~rows])


def add_track(clip: Clip, category: str, start_SE3_box: Float64, lwh_m: Float64) -> Clip:
    """Add a road user that stands or moves.

    Args:
        clip: the clip.
        category: one of `CATEGORIES`.
        start_SE3_box: (4, 4), or (F, 4, 4) for a moving one: poses in the ego frame of the clip's first instant.
        lwh_m: (3,) length, width, height.

    Raises:
        UsageError: the class is unknown, or the poses are not one for each frame.
        DatasetError: a number is not valid.
    """
    if category not in CATEGORIES:
        raise UsageError(f"a road user {category!r}", expected=f"one of {', '.join(CATEGORIES)}")
    frames = len(clip)
    if start_SE3_box.shape not in ((4, 4), (frames, 4, 4)):
        raise UsageError(f"poses of shape {start_SE3_box.shape}", expected=f"(4, 4) or ({frames}, 4, 4)")
    poses = np.linalg.inv(clip.start_SE3_ego) @ start_SE3_box
    number = int(clip.boxes.track.max(initial=-1)) + 1
    new = ClipBoxes(
        np.arange(frames), np.full(frames, number), np.full(frames, CATEGORIES.index(category)), poses,
        np.tile(lwh_m, (frames, 1)),
    )  # fmt: skip
    joined = {
        field.name: np.concatenate([getattr(one, field.name) for one in (clip.boxes, new)]) for field in fields(new)
    }
    return replace(clip, boxes=ClipBoxes(**joined))


def _rows(clip: Clip, track: int) -> np.ndarray:
    rows = clip.boxes.track == track
    if not rows.any():
        raise UsageError(
            f"no box of track {track}", place=clip.clip_id,
            expected=f"one of {', '.join(map(str, np.unique(clip.boxes.track)[:20]))}",
        )  # fmt: skip
    return np.asarray(rows)
