"""Edits of a scene as words: ``move:TRACK:dy=1.5``, ``remove:TRACK``, ``add:CLASS:at=X,Y,HEADING``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from hybridworldsim.generation.clips.clip import CATEGORIES, Clip, ClipBoxes
from hybridworldsim.generation.clips.edits import add_track, move_track, remove_track
from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.geometry.poses import Poses

_FORM: Final = "move:TRACK:dx=METRES,dy=METRES, remove:TRACK, or add:CLASS:at=X,Y,HEADING_DEG (world frame)"
SIZES_M: Final[Mapping[str, tuple[float, float, float]]] = {
    "car": (4.5, 1.85, 1.5),
    "van": (5.6, 2.0, 2.3),
    "truck": (8.0, 2.5, 3.2),
    "bus": (12.0, 2.55, 3.1),
    "motorcycle": (2.2, 0.8, 1.5),
    "cyclist": (1.8, 0.6, 1.8),
    "pedestrian": (0.6, 0.6, 1.75),
}
"""Length, width and height of an added road user."""


@dataclass(frozen=True)
class SceneEdit:
    """One edit of a road user in a generated scene.

    Attributes:
        kind: what is done.
        name: track id, or for ``add`` the class.
        numbers: dx and dy in metres, or x and y in metres and the heading in degrees.
    """

    kind: Literal["move", "remove", "add"]
    name: str
    numbers: tuple[float, ...] = ()


def parse_edit(text: str, tracks: Mapping[str, int]) -> SceneEdit:
    """Parse one edit from its text.

    Args:
        text: the words of ``--edit``.
        tracks: road users of the traversal by track id.

    Raises:
        UsageError: the text has another form, or the track or class does not exist.
    """
    kind, _, rest = text.partition(":")
    name, _, values = rest.partition(":")
    if kind not in ("move", "remove", "add") or not name or (kind == "remove") == bool(values):
        raise UsageError(f"{text!r}", place="--edit", expected=_FORM)
    if kind == "add" and name not in CATEGORIES:
        raise UsageError(f"a road user {name!r}", place="--edit", expected=f"one of {', '.join(CATEGORIES)}")
    if kind != "add" and name not in tracks:
        listed = ", ".join(sorted(tracks)[:12]) or "no track: the traversal has no boxes"
        raise UsageError(f"no track {name!r}", place="--edit", expected=f"a track of the traversal, such as {listed}")
    try:
        if kind == "move":
            pairs = dict(part.split("=") for part in values.split(","))
            if not pairs or set(pairs) - {"dx", "dy"}:
                raise ValueError(values)
            numbers: tuple[float, ...] = (float(pairs.get("dx", 0.0)), float(pairs.get("dy", 0.0)))
        elif kind == "add":
            key, _, listed = values.partition("=")
            numbers = tuple(float(part) for part in listed.split(","))
            if key != "at" or len(numbers) != 3:
                raise ValueError(values)
        else:
            numbers = ()
        if not np.isfinite(numbers).all():
            raise ValueError(values)
    except ValueError as error:
        raise UsageError(f"{text!r}", place="--edit", expected=_FORM) from error
    return SceneEdit(kind, name, numbers)  # type: ignore[arg-type]


def require_shown(edits: Sequence[SceneEdit], boxes: ClipBoxes, tracks: Mapping[str, int]) -> None:
    """Check that each road user that an edit moves has a box in the generated frames and was not removed before.

    Args:
        edits: in order.
        boxes: those of the generated frames.
        tracks: numbers of road users by track id.

    Raises:
        UsageError: it has no box in these frames, or an earlier edit removes it.
    """
    removed: set[str] = set()
    for edit in edits:
        if edit.kind == "remove":
            removed.add(edit.name)
        elif edit.kind == "move" and edit.name in removed:
            raise UsageError(
                f"track {edit.name!r} is moved after it is removed", place="--edit", expected="one of both"
            )
        elif edit.kind == "move" and not (boxes.track == tracks[edit.name]).any():
            raise UsageError(
                f"track {edit.name!r} has no box in the generated frames", place="--edit",
                expected=f"a track of a class that is generated ({', '.join(CATEGORIES)}), recorded behind the seeds",
                remedy="choose another track, or generate more --frames",
            )  # fmt: skip


def apply_edits(
    clip: Clip, edits: Sequence[SceneEdit], tracks: Mapping[str, int], world_SE3_start: Poses, driven_m: Float64
) -> Clip:
    """Apply edits to the boxes of a clip; an edit of a track without boxes in the clip changes nothing.

    Args:
        clip: the clip.
        edits: in order.
        tracks: numbers of road users by track id.
        world_SE3_start: the ego pose of the clip's first frame (one).
        driven_m: (N, 3) places of the vehicle in the whole scene, world frame: an added road user stands at the height
            of the nearest one.
    """
    for edit in edits:
        if edit.kind == "add":
            clip = add_track(clip, edit.name, _placed(edit, world_SE3_start, driven_m), np.array(SIZES_M[edit.name]))
        elif not (clip.boxes.track == tracks[edit.name]).any():
            continue
        elif edit.kind == "move":
            clip = move_track(clip, tracks[edit.name], dx=edit.numbers[0], dy=edit.numbers[1])
        else:
            clip = remove_track(clip, tracks[edit.name])
    return clip


def _placed(edit: SceneEdit, world_SE3_start: Poses, driven_m: Float64) -> Float64:
    x, y, heading_deg = edit.numbers
    half = np.radians(heading_deg) / 2.0
    nearest = np.argmin(np.linalg.norm(driven_m[:, :2] - (x, y), axis=1))
    height = driven_m[nearest, 2] + SIZES_M[edit.name][2] / 2.0
    pose = Poses(np.array([[np.cos(half), 0.0, 0.0, np.sin(half)]]), np.array([[x, y, height]]))
    matrix: Float64 = (world_SE3_start.inverse() @ pose).matrix()[0]
    return matrix
