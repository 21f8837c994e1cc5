"""Puts the lens of a camera into a recording of the `folder` layout."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

from mirror.errors import RecordingError, UsageError
from mirror.geometry.cameras import Camera
from mirror.recordings.calibration import Calibration, to_calibration
from mirror.recordings.folder_document import DOCUMENT_NAME, read_calibrations, read_document
from mirror.recordings.opening import find_file, read_json, require_file
from mirror.schema.files import write_bytes

FACTORY: Final = "calibrations/factory.json"


def write_calibrations(root: Path, calibrations: list[Calibration]) -> None:
    """Write ``calibrations/factory.json`` of a recording."""
    (root / FACTORY).parent.mkdir(exist_ok=True)
    plain = [calibration.model_dump(mode="json") for calibration in calibrations]
    write_bytes(root / FACTORY, (json.dumps(plain, indent=2) + "\n").encode())


def require_lens_place(root: Path, camera: str, mounting: tuple[float, ...] | None) -> None:
    """Refuse, before a lens is estimated, a recording that cannot take the lens of a camera.

    Raises:
        RecordingError: there is no such camera, or its factory calibration has intervals of validity.
        UsageError: the mounting is not known.
    """
    document = read_document(require_file(root, DOCUMENT_NAME))
    if camera not in document.cameras:
        raise RecordingError(
            f"there is no camera {camera!r}", file=root / DOCUMENT_NAME, place="cameras",
            expected=f"one of {', '.join(document.cameras) or 'no cameras'}", remedy="name another --camera",
        )  # fmt: skip
    own = [entry for entry in _existing(root) if entry.camera == camera]
    if len(own) > 1:
        raise RecordingError(
            f"camera {camera!r} has {len(own)} intervals of validity", file=root / FACTORY,
            expected="one factory calibration of the camera", remedy="edit the file: the lens is in --out",
        )  # fmt: skip
    if not own and mounting is None:
        raise UsageError(
            f"the recording has no mounting of camera {camera!r}", file=root, place="--mounting",
            expected="the pose of the camera on the vehicle",
            remedy="add --mounting x,y,z,roll,pitch,yaw (metres and degrees)",
        )  # fmt: skip


def put_lens(root: Path, camera: str, lens: Camera, mounting: tuple[float, ...] | None, method: str) -> None:
    """Write a lens into the factory calibration of a recording, and declare its camera as calibrated.

    Args:
        root: the recording.
        camera: the camera's name.
        lens: the lens.
        mounting: ``ego_SE3_camera``; None: that of the existing calibration is kept.
        method: how the lens was obtained.

    Raises:
        RecordingError: as in `require_lens_place`.
        UsageError: as in `require_lens_place`.
    """
    require_lens_place(root, camera, mounting)
    existing = _existing(root)
    old = next((entry for entry in existing if entry.camera == camera), None)
    pose = mounting if mounting is not None else old.ego_SE3_camera if old is not None else ()
    kept: dict[str, Any] = {}
    if old is not None:
        names = ("time_offset_ns", "shutter_direction", "readout_ns", "valid_from_ns", "valid_to_ns")
        kept = {name: getattr(old, name) for name in names}
        kept["covariance"] = old.covariance if mounting is None else None
    entry = to_calibration(camera, lens, pose, method, **kept)
    write_calibrations(root, [entry if one is old else one for one in existing] + ([entry] if old is None else []))
    file = require_file(root, DOCUMENT_NAME)
    document = read_json(file)
    if document["cameras"][camera].pop("calibrated", True) is False:
        write_bytes(file, (json.dumps(document, indent=2) + "\n").encode())


def _existing(root: Path) -> list[Calibration]:
    file = find_file(root, FACTORY)
    return read_calibrations(file) if file is not None else []
