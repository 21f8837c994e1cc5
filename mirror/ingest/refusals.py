"""What a recording states and cannot be: boxes without size or place, images of another raster than their camera's."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from mirror.arrays import Bool, Float64, Int64, UInt8
from mirror.errors import RecordingError
from mirror.recordings.coordinates import is_invalid_rotation

_SIZE = ("length_m", "width_m", "height_m")
_CENTRE = ("tx_m", "ty_m", "tz_m")
_QUATERNION = ("qw", "qx", "qy", "qz")
_OPTIONAL = ("vx_mps", "vy_mps", "vz_mps")
# Beyond this no ego frame has objects, and squares of metres still are numbers.
_FARTHEST_M = 1e6


def refuse_invalid_boxes(boxes: pa.Table, file: Path) -> None:
    """Refuse boxes that are nowhere or have no extent.

    Args:
        boxes: rows of the `boxes` table.
        file: the recording, for the message.

    Raises:
        RecordingError: a number is NaN or infinite, a length, width or height is not positive, a centre is over
            1,000 km away, a quaternion is off unit length by over 1 %, or a score is not in 0 to 1; the row is named.
    """
    size, centre, rotation = (_columns(boxes, names) for names in (_SIZE, _CENTRE, _QUATERNION))
    velocity, score = _columns(boxes, _OPTIONAL), _columns(boxes, ("score",))
    known = np.column_stack([np.asarray(boxes.column(name).is_valid()) for name in (*_OPTIONAL, "score")])
    faults: tuple[tuple[str, npt.ArrayLike, Float64, str], ...] = (
        ("size", ~((size > 0) & (size <= _FARTHEST_M)).all(axis=1), size, "length, width and height above 0 m"),
        ("centre", ~(np.abs(centre) <= _FARTHEST_M).all(axis=1), centre, "metres in the ego frame"),
        ("quaternion", is_invalid_rotation(rotation), rotation, "a unit quaternion, scalar first"),
        ("velocity", (known[:, :3] & ~np.isfinite(velocity)).any(axis=1), velocity, "metres a second, or null"),
        ("score", known[:, 3] & ~((score >= 0) & (score <= 1))[:, 0], score, "0 to 1, or null"),
    )
    for what, found, values, expected in faults:
        bad: Bool = np.asarray(found, np.bool_)
        if bad.any():
            row = int(np.argmax(bad))
            raise RecordingError(
                f"a box of {what} {values[row].tolist()}" + _more(bad, "rows"),
                file=file,
                place=f"boxes, row {row}, track {boxes.column('track_id')[row].as_py()}",
                expected=expected,
                remedy="correct or remove the row where the boxes come from",
            )


def refuse_other_image_sizes(
    camera: str, width_px: Int64, height_px: Int64, files: Sequence[str], calibrations: pa.Table
) -> None:
    """Refuse images of another size than their camera's calibration, as every projection would be wrong.

    Args:
        camera: the images' camera.
        width_px: (N,) of each image.
        height_px: (N,) of each image.
        files: (N,) their files, for the message.
        calibrations: rows of the `calibrations` table of the drive; a camera without any has no size of its own.

    Raises:
        RecordingError: naming the first such image, and the calibration.
    """
    for row in calibrations.select(["camera", "stage", "width_px", "height_px"]).to_pylist():
        if row["camera"] != camera:
            continue
        other = (width_px != row["width_px"]) | (height_px != row["height_px"])
        if other.any():
            first = int(np.argmax(other))
            raise RecordingError(
                f"{width_px[first]} x {height_px[first]} px, but its camera is calibrated ({row['stage']}) for"
                f" {row['width_px']} x {row['height_px']} px" + _more(other, "images"),
                file=files[first],
                place=f"camera {camera}",
                expected="images of the calibrated raster",
                remedy="scale the calibration to the images, or restore the images",
            )


def refuse_other_mask_size(camera: str, mask: UInt8, width_px: Int64, height_px: Int64, files: Sequence[str]) -> None:
    """Refuse images of another size than their camera's mask, as the mask would hide other pixels.

    Args:
        camera: the images' camera.
        mask: (H, W) mask of the recording vehicle.
        width_px: (N,) of each image.
        height_px: (N,) of each image.
        files: (N,) their files, for the message.

    Raises:
        RecordingError: naming the first such image.
    """
    height, width = mask.shape
    other = (width_px != width) | (height_px != height)
    if other.any():
        first = int(np.argmax(other))
        raise RecordingError(
            f"{width_px[first]} x {height_px[first]} px, but the static mask of its camera has {width} x {height} px"
            + _more(other, "images"),
            file=files[first], place=f"camera {camera}", expected="a mask of the size of the images",
            remedy="draw the mask on an image of the camera, or take static_mask out of the recording's document",
        )  # fmt: skip


def _more(bad: Bool, what: str) -> str:
    count = int(np.count_nonzero(bad))
    return f" ({count} such {what})" if count > 1 else ""


def _columns(table: pa.Table, names: Sequence[str]) -> Float64:
    return np.column_stack([np.asarray(table.column(name).cast(pa.float64()), np.float64) for name in names])
