"""COLMAP's camera models in MIRROR's words; both have the centre of the first pixel at (0.5, 0.5)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from mirror.errors import RecordingError
from mirror.recordings.readers.colmap_model import ColmapCamera

# By COLMAP's model: whether it has one focal length, MIRROR's model, and the place of each parameter behind the
# principal point among MIRROR's coefficients.
_LENSES: Final[dict[str, tuple[bool, str, int, tuple[int, ...]]]] = {
    "SIMPLE_PINHOLE": (True, "pinhole", 0, ()),
    "PINHOLE": (False, "pinhole", 0, ()),
    "SIMPLE_RADIAL": (True, "brown_conrady", 5, (0,)),
    "RADIAL": (True, "brown_conrady", 5, (0, 1)),
    "OPENCV": (False, "brown_conrady", 5, (0, 1, 2, 3)),
    "FULL_OPENCV": (False, "rational", 8, (0, 1, 2, 3, 4, 5, 6, 7)),
    "SIMPLE_FISHEYE": (True, "kannala_brandt", 4, ()),
    "FISHEYE": (False, "kannala_brandt", 4, ()),
    "SIMPLE_RADIAL_FISHEYE": (True, "kannala_brandt", 4, (0,)),
    "RADIAL_FISHEYE": (True, "kannala_brandt", 4, (0, 1)),
    "OPENCV_FISHEYE": (False, "kannala_brandt", 4, (0, 1, 2, 3)),
}


def to_lens(camera: ColmapCamera, file: Path, place: str) -> dict[str, Any]:
    """Return the model, focal lengths, principal point and distortion, by the names of `Calibration`.

    Args:
        camera: COLMAP's camera.
        file: the file of cameras, for the message.
        place: the camera's place in it.

    Raises:
        RecordingError: MIRROR has no such model.
    """
    if camera.model not in _LENSES:
        raise RecordingError(
            f"the camera model {camera.model} is not supported",
            file=file,
            place=place,
            expected=f"one of {', '.join(_LENSES)}",
            remedy="undistort the images with `colmap image_undistorter`, or reconstruct with another model",
        )
    single, model, count, places = _LENSES[camera.model]
    focal, rest = camera.parameters[: 1 if single else 2], camera.parameters[1 if single else 2 :]
    distortion = [0.0] * count
    for place_of, value in zip(places, rest[2:]):
        distortion[place_of] = value
    return {
        "model": model,
        "fx_px": focal[0],
        "fy_px": focal[-1],
        "cx_px": rest[0],
        "cy_px": rest[1],
        "distortion": tuple(distortion),
    }
