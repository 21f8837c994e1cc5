"""Boxes of KITTI raw: ``tracklet_labels.xml``, which holds each road user with its poses in consecutive frames.

A pose is that of the middle of the box's bottom, in the frame of the lidar at the frame's instant: ``tx ty tz``, and
``rz``, the turn about z. Sizes ``h w l`` are those of the whole tracklet. The format is that of a C++ library which
writes lists as ``count``, ``item_version`` and elements ``item``.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from mirror.arrays import Float64, Int64
from mirror.errors import RecordingError
from mirror.geometry.poses import Poses
from mirror.recordings.opening import read_file, unreadable_error
from mirror.recordings.readers.box_rows import make_box_table, rotation_about_up
from mirror.recordings.readers.kitti_files import NO_STAMP
from mirror.recordings.readers.stored_poses import REMEDY

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


def read_tracklets(file: Path, by_frame: Int64, ego_SE3_lidar: Poses) -> pa.Table:
    """Read rows of the ``boxes`` table, without velocity.

    Args:
        file: ``tracklet_labels.xml``.
        by_frame: stamps of the frames by their number.
        ego_SE3_lidar: one pose.

    Raises:
        RecordingError: the file is broken, a box has no number or is tilted, or its frame has no stamp; tracklet and
            pose are named.
    """
    from xml.etree import ElementTree

    data = read_file(file)
    if b"<!ENTITY" in data:
        raise RecordingError("the file declares entities", file=file, expected="plain XML", remedy=REMEDY)
    try:
        root = ElementTree.fromstring(data)
    except (ElementTree.ParseError, LookupError, ValueError) as error:
        raise unreadable_error(file, error) from error
    tracklets = root.findall("tracklets/item")
    if root.find("tracklets") is None:
        raise RecordingError("no tracklets", file=file, expected="an element tracklets", remedy=REMEDY)
    names, frames, sizes, values, labels = [], [], [], [], []
    for number, tracklet in enumerate(tracklets):
        place = f"tracklet {number}"
        height, width, length, first = _numbers(tracklet, ("h", "w", "l", "first_frame"), file, place)
        label = (tracklet.findtext("objectType") or "").strip()
        if not label:
            raise _error("no objectType", file, place)
        for index, pose in enumerate(tracklet.findall("poses/item")):
            at = f"{place}, pose {index}"
            numbers = _numbers(pose, ("tx", "ty", "tz", "rx", "ry", "rz"), file, at)
            frame = first + index
            if not 0 <= frame < len(by_frame) or frame != int(frame) or by_frame[int(frame)] == NO_STAMP:
                raise _error(f"frame {frame:g} has no stamp", file, at)
            if numbers[3] or numbers[4]:
                raise _error(f"the box is tilted by rx {numbers[3]:g}, ry {numbers[4]:g}", file, at)
            names.append(str(number))
            labels.append(label)
            frames.append(int(frame))
            sizes.append((length, width, height))
            values.append(numbers)
    size: Float64 = np.array(sizes, np.float64).reshape(-1, 3)
    table: Float64 = np.array(values, np.float64).reshape(-1, 6)
    up = np.outer(0.5 * size[:, 2], (0.0, 0.0, 1.0))
    lidar_SE3_box = Poses(rotation_about_up(table[:, 5]), table[:, :3] + up)
    columns = {
        "timestamp_ns": by_frame[np.array(frames, np.int64)],
        "track_id": names,
        "category": labels,
        "source": "kitti",
        "source_version": "tracklets",
    }
    return make_box_table(ego_SE3_lidar @ lidar_SE3_box, size, columns)


def _numbers(element: Element, names: tuple[str, ...], file: Path, place: str) -> list[float]:
    found = []
    for name in names:
        text = (element.findtext(name) or "").strip()
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not abs(value) < 1e9:
            raise _error(f"{name} is {text!r:.80}", file, place)
        found.append(value)
    return found


def _error(problem: str, file: Path, place: str) -> RecordingError:
    return RecordingError(
        problem,
        file=file,
        place=place,
        expected="a tracklet: objectType, h w l in metres, and poses from first_frame on, turned about z alone",
        remedy="download the tracklets again, or leave them out: --option boxes=no",
    )
