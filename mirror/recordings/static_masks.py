"""Read the masks of recordings: one PNG a camera, non-zero where the image shows the recording vehicle."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mirror.arrays import UInt8
from mirror.errors import RecordingError
from mirror.recordings.opening import find_file, read_file
from mirror.recordings.paths import require_inside
from mirror.recordings.raster import MAX_PIXELS, is_decodable


def read_static_mask(folder: Path, name: str | None, camera: str, document: Path) -> UInt8 | None:
    """Read the mask (H, W) of a camera that a document names; None if it names no mask.

    Args:
        folder: the folder that the name is relative to, and that it must not lead out of.
        name: the mask's name in the folder, or None.
        camera: the camera's name.
        document: the file with the entry ``cameras.CAMERA.static_mask``.

    Raises:
        RecordingError: the file is missing, outside of the folder, or no image.
    """
    if name is None:
        return None
    require_inside(folder, name, file=document, place=f"cameras.{camera}.static_mask")
    return decode_static_mask(
        find_file(folder, name), folder / name, camera, f"take static_mask out of {document.name}"
    )


def decode_static_mask(found: Path | None, file: Path, camera: str, way_out: str) -> UInt8:
    """Decode the mask (H, W) of a camera.

    Args:
        found: the file, or None if there is none.
        file: the file's name in messages.
        camera: the camera's name.
        way_out: how to do without the mask, in words.

    Raises:
        RecordingError: the file is missing or no image.
    """
    import cv2

    data = read_file(found) if found is not None else b""
    mask = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if is_decodable(data) else None
    if mask is None:
        raise RecordingError(
            "the mask is missing" if found is None else f"the mask is not an image of at most {MAX_PIXELS} pixels",
            file=file,
            place=f"camera {camera}",
            expected="a PNG of the camera's raster",
            remedy=f"restore it, or {way_out}",
        )
    return np.asarray(mask, np.uint8)
