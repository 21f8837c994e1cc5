"""Boxes of KITTI-360: an XML file for each drive, with objects of one frame and static objects of a window of frames.

An object is a mesh in the unit cube, and a 4x4 matrix that scales, turns and moves it into the dataset's world. Its
``timestamp`` is the number of a frame, or -1 for an object that does not move: such an object was labelled in the
frames ``start_frame`` to ``end_frame``. It becomes a box, at rest, in each of these frames within `RANGE_M`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
import pyarrow as pa

from mirror.arrays import Float64, Int64
from mirror.errors import RecordingError
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import quaternion_from_matrix
from mirror.recordings.opening import find_file, unreadable_error
from mirror.recordings.readers.box_rows import make_box_table, velocity_columns
from mirror.recordings.readers.kitti_files import NO_STAMP
from mirror.recordings.readers.stored_poses import REMEDY

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

RANGE_M: Final = 80.0
"""Largest distance of a static object from the vehicle in the frames in which it has a box."""

_FOLDERS: Final = ("train_full", "train", "test")
_STATIC: Final = -1
_SHEAR: Final = 0.02
_MOVABLE: Final = frozenset(
    ("car", "truck", "bus", "train", "motorcycle", "bicycle", "caravan", "trailer", "person", "rider", "unknownvehicle")
)


@dataclass(frozen=True)
class _Object:
    """One object of the file: its box in the world, and the frames in which it is there."""

    track_id: str
    label: str
    timestamp: int
    first: int
    last: int
    rotation: Float64
    centre: Float64
    size: Float64


def find_boxes(root: Path, drive: str) -> Path | None:
    """Find the file of a drive's boxes in the first of ``train_full``, ``train`` and ``test`` that has one."""
    for folder in _FOLDERS:
        file = find_file(root, f"data_3d_bboxes/{folder}/{drive}.xml")
        if file is not None:
            return file
    return None


def read_boxes(file: Path, by_frame: Int64, pose_ns: Int64, world_SE3_ego: Poses, *, all_kinds: bool) -> pa.Table:
    """Read rows of the ``boxes`` table.

    Args:
        file: the XML file.
        by_frame: stamps of the frames by their number.
        pose_ns: (M,) ascending stamps of the vehicle's poses.
        world_SE3_ego: the M poses.
        all_kinds: objects of all kinds; False: road users alone.

    Returns:
        Boxes at the frames between the first and the last pose. Those of an object at rest have the velocity 0; the
        velocity of others is not stated.

    Raises:
        RecordingError: the file is broken, or an object has no box; the object is named.
    """
    frames = np.arange(len(by_frame))
    usable = frames[(by_frame != NO_STAMP) & (by_frame >= pose_ns[0]) & (by_frame <= pose_ns[-1])]
    ego = interpolate(pose_ns, world_SE3_ego, by_frame[usable])
    objects = [one for one in _objects(file) if all_kinds or one.label.replace(" ", "").lower() in _MOVABLE]
    owners, places = [], []
    for number, one in enumerate(objects):
        if one.timestamp != _STATIC:
            place = int(np.searchsorted(usable, one.timestamp))
            found = [place] if place < len(usable) and usable[place] == one.timestamp else []
            near: Int64 = np.array(found, np.int64)
        else:
            start, end = np.searchsorted(usable, one.first), np.searchsorted(usable, one.last, side="right")
            distance = np.linalg.norm(ego.translation[start:end] - one.centre, axis=1)
            near = start + np.flatnonzero(distance <= RANGE_M)
        owners.append(np.full(len(near), number))
        places.append(near)
    owner = np.concatenate(owners) if owners else np.empty(0, np.int64)
    place_of = np.concatenate(places) if places else np.empty(0, np.int64)
    owner, place_of = _once(objects, owner, place_of)
    if not len(owner):
        return make_box_table(Poses.identity(0), np.empty((0, 3)), {})
    rotation, centre, size = (
        np.stack([getattr(one, name) for one in objects]) for name in ("rotation", "centre", "size")
    )
    static = np.array([one.timestamp == _STATIC for one in objects])
    columns = {
        "timestamp_ns": by_frame[usable[place_of]],
        "track_id": [objects[number].track_id for number in owner.tolist()],
        "category": [objects[number].label for number in owner.tolist()],
        **velocity_columns(np.where(static[owner][:, None], np.zeros((1, 3)), np.nan)),
        "source": "kitti360",
        "source_version": file.parent.name,
    }
    return make_box_table(ego[place_of].inverse() @ Poses(rotation[owner], centre[owner]), size[owner], columns)


def _once(objects: list[_Object], owner: Int64, place: Int64) -> tuple[Int64, Int64]:
    """Each track once in a frame: windows of static objects may overlap."""
    names = {name: number for number, name in enumerate(dict.fromkeys(one.track_id for one in objects))}
    track = np.array([names[one.track_id] for one in objects], np.int64)
    _, first = np.unique(np.stack([track[owner], place]), axis=1, return_index=True) if len(owner) else ([], owner)
    kept = np.sort(np.asarray(first, np.int64))
    return owner[kept], place[kept]


def _objects(file: Path) -> Iterator[_Object]:
    """The objects of the file, one after the other: the whole tree of a long drive does not fit into memory."""
    from xml.etree import ElementTree

    try:
        with file.open("rb") as opened:
            depth = 0
            root: Element | None = None
            for event, element in ElementTree.iterparse(opened, events=("start", "end")):
                depth += 1 if event == "start" else -1
                if root is None:
                    root = element
                if event == "end" and depth == 1:
                    if element.find("transform") is not None:
                        yield _read_object(element, file)
                    root.clear()
    except (OSError, ElementTree.ParseError, LookupError) as error:
        raise unreadable_error(file, error) from error


def _read_object(element: Element, file: Path) -> _Object:
    try:
        transform, vertices = _matrix(element, "transform", (4, 4)), _matrix(element, "vertices", (-1, 3))
        numbers = {name: int(_text(element, name)) for name in ("timestamp", "start_frame", "end_frame")}
        names = [_text(element, name) for name in ("semanticId", "instanceId", "label")]
        rotation, scale = _decompose(transform[:3, :3])
        low, high = vertices.min(axis=0), vertices.max(axis=0)
        return _Object(
            track_id=f"{names[0]}_{names[1]}",
            label=names[2],
            timestamp=numbers["timestamp"],
            first=numbers["start_frame"],
            last=numbers["end_frame"],
            rotation=quaternion_from_matrix(rotation[None])[0],
            centre=transform[:3, :3] @ (0.5 * (low + high)) + transform[:3, 3],
            size=scale * (high - low),
        )
    except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
        raise RecordingError(
            f"no box: {error}",
            file=file,
            place=f"element {element.tag}",
            expected="an object of KITTI-360 with a matrix that scales, turns and moves",
            remedy=REMEDY,
        ) from error


def _text(element: Element, name: str) -> str:
    text = element.findtext(name)
    if text is None or not text.strip():
        raise ValueError(f"no {name}")
    return text.strip()


def _matrix(element: Element, name: str, shape: tuple[int, int]) -> Float64:
    node = element.find(name)
    if node is None:
        raise ValueError(f"no {name}")
    values = np.array(_text(node, "data").split(), np.float64)
    if not len(values) or not (np.abs(values) < 1e9).all():
        raise ValueError(f"the numbers of {name} are none, or no metres")
    return values.reshape(shape)


def _decompose(matrix: Float64) -> tuple[Float64, Float64]:
    """The rotation and the scales along its axes of a matrix (3, 3), by its polar decomposition.

    Raises:
        ValueError: the matrix shears by more than `_SHEAR`, or is flat.
    """
    left, stretch, right = np.linalg.svd(matrix)
    rotation, scale = left @ right, right.T @ np.diag(stretch) @ right
    along = np.diag(scale)
    if not stretch[-1] > 1e-6 or np.abs(scale - np.diag(along)).max() > _SHEAR * along.min():
        raise ValueError("the matrix shears, or is flat")
    # A mirrored box is the same box.
    return rotation * (1.0, np.sign(np.linalg.det(rotation)), 1.0), along
