"""Reads the JSON of a DGP scene: its data with their stamps and poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

import numpy as np

from mirror.errors import RecordingError
from mirror.geometry.poses import Poses
from mirror.recordings.coordinates import is_invalid_rotation
from mirror.recordings.opening import read_json

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_LAST_YEAR: Final = 2200


@dataclass(frozen=True)
class Datum:
    """One image or point cloud.

    Attributes:
        sensor: the sensor's name.
        kind: ``image``, ``point_cloud`` ...
        stamp: the text of its stamp.
        timestamp_ns: Unix time; None: the text is not a date and time.
        rotation: quaternion of ``world_SE3_sensor`` as written, not checked.
        translation: translation of ``world_SE3_sensor`` as written, not checked.
        calibration: key of its calibration.
        content: the JSON object of its kind.
    """

    sensor: str
    kind: str
    stamp: str
    timestamp_ns: int | None
    rotation: tuple[float, ...]
    translation: tuple[float, ...]
    calibration: str
    content: Mapping[str, Any]


def read_datum(entry: Mapping[str, Any], calibration: Mapping[str, str]) -> Datum:
    """Read one entry of a scene's data.

    Args:
        entry: the entry.
        calibration: key of the calibration of each datum, by the key of the datum.

    Raises:
        KeyError, TypeError, ValueError, AttributeError: the entry is malformed.
    """
    (kind, content), *others = entry["datum"].items()
    if others:
        raise ValueError(f"kinds {', '.join(entry['datum'])} in one datum")
    identity, key = entry["id"], entry["key"]
    if key not in calibration:
        raise ValueError(f"no sample names the datum {key!r:.80}")
    rotation, translation = _components(content["pose"])
    for name in dict(content.get("annotations") or {}).values():
        require_text(name)
    if kind == "image":
        require_text(content["filename"])
        _ = content["width"], content["height"]
    stamp = str(identity["timestamp"])
    return Datum(
        sensor=require_text(identity["name"]),
        kind=kind,
        stamp=stamp,
        timestamp_ns=_stamp_ns(stamp),
        rotation=rotation,
        translation=translation,
        calibration=calibration[key],
        content=content,
    )


def require_text(value: object) -> str:
    """Return a value that must be a text.

    Raises:
        TypeError: it is none.
    """
    if not isinstance(value, str):
        raise TypeError(f"{value!r:.80} is not a text")
    return value


def read_pose(entry: Mapping[str, Any]) -> Poses:
    """Read a pose that the scene needs.

    Raises:
        KeyError, TypeError: the entry is not a pose.
        ValueError: the quaternion is off unit length: a component that is not zero may be missing.
    """
    rotation, translation = (np.array([values]) for values in _components(entry))
    if is_invalid_rotation(rotation)[0]:
        raise ValueError(f"{rotation[0].tolist()} is no rotation")
    return Poses(rotation, translation)


def _stamp_ns(text: str) -> int | None:
    try:
        moment = datetime.fromisoformat(text)
        microseconds = (moment - _EPOCH) // timedelta(microseconds=1)
    except (TypeError, ValueError):
        return None
    return microseconds * (100 if moment.year > _LAST_YEAR else 1_000)


def _components(entry: Mapping[str, Any]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    rotation, translation = entry["rotation"], entry["translation"]
    # Protocol buffers that are written as JSON may leave zeros out.
    return (
        tuple(float(rotation.get(f"q{axis}", 0.0)) for axis in "wxyz"),
        tuple(float(translation.get(axis, 0.0)) for axis in "xyz"),
    )


def read_object(file: Path) -> dict[str, Any]:
    """Read a file that holds one JSON object.

    Raises:
        RecordingError: the file is missing or broken, or holds another value.
    """
    document = read_json(file)
    if not isinstance(document, dict):
        raise RecordingError("not a JSON object", file=file, expected="a DGP document")
    return document
