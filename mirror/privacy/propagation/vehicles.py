"""The geometric fallback for number plates: the strips at the front and rear of vehicles' 3D boxes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64, Int64
from mirror.errors import UsageError
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses
from mirror.privacy.propagation.bodies import find_hidden
from mirror.privacy.propagation.mounts import PlateMount, find_mount
from mirror.privacy.regions import Region, region_at

SOURCE: Final = "vehicle_boxes"
_DEPTH_M: Final = 0.15
"""Largest distance of a plate from the end of its box: bumpers are curved, tailgates are inclined."""
_LEAST_COSINE: Final = 0.17
"""Plates that are seen at more than 80 degrees are not readable."""
_PLATE_M: Final = (0.52, 0.11)
"""Width and height of the largest plate of one row."""
_LEAST_SEEN: Final = 0.4
"""Share of a plate's width that must be in the image and unhidden: with less, two of seven characters are whole."""
_LARGEST_ERROR_M: Final = 2.0
_COLUMNS, _ROWS = 9, 5
"""Places at which a plate is looked for, across and up."""
_LEAST_HELD: Final = 0.75
"""Share of the expected plate's width and height that a detected one holds, before it is enlarged."""
_WIDEST, _LOWEST, _TALLEST = 1.8, 0.4, 3.0
"""Size of a detected plate in that of the expected one: plates of two rows are higher."""
_SURE: Final = 0.5
"""Score from which a detected part of a plate tells at what height the plate is."""


@dataclass(frozen=True)
class StripOptions:
    """The places where the fallback expects plates.

    Attributes:
        least_px: width of a plate, as it appears, from which it is removed; at 20, a character has three pixels.
        box_error_m: error of the boxes: strips are larger by it at each side, and what hides them is smaller.

    Raises:
        UsageError: a value is out of its range.
    """

    least_px: float = 20.0
    box_error_m: float = 0.0

    def __post_init__(self) -> None:
        if not self.least_px > 0.0:
            raise UsageError(f"plates from {self.least_px} px", expected="a width above 0")
        if not 0.0 <= self.box_error_m <= _LARGEST_ERROR_M:
            raise UsageError(
                f"boxes with an error of {self.box_error_m} m", expected=f"a value from 0 to {_LARGEST_ERROR_M} m"
            )


@dataclass(frozen=True, eq=False)
class _End:
    """One end of a vehicle in the image.

    Attributes:
        strip_px: (4,) bounds of the strip; they may reach beyond the image.
        plate_px: (4,) bounds of a plate in the middle of it.
        points: (R, C, 3) places of plates in the camera frame, a row for each height.
        in_image: (R, C) which of them the image shows.
    """

    strip_px: Float64
    plate_px: Float64
    points: Float64
    in_image: Bool


def plate_strips(
    camera: Camera,
    camera_SE3_box: Poses,
    size_m: Float64,
    category: Sequence[str],
    detected: Sequence[Region],
    options: StripOptions | None = None,
    *,
    grow: float = 0.3,
) -> list[Region]:
    """Find where vehicles carry plates that no detector found.

    An end of a vehicle has no strip if it carries no plate, faces away or is too far to be read; if the bodies of
    other vehicles hide each place of a plate; and if a detector found a plate of the size and at the place that the
    box lets expect.

    Args:
        camera: the camera.
        camera_SE3_box: N poses of boxes in the camera frame; their x axis points ahead, their z axis up.
        size_m: (N, 3) length, width and height.
        category: N categories; which of them carry plates, and where, says `mirror.privacy.propagation.mounts`.
        detected: regions of the image.
        options: where plates are expected; None: as by default.
        grow: share by which regions will be enlarged: strips are as much smaller than what is to be removed.

    Returns:
        Regions of kind `plate` and origin `vehicle`; they may reach beyond the image.
    """
    chosen, plates = options or StripOptions(), [one for one in detected if one.kind == "plate"]
    strips = []
    for row, name in enumerate(category):
        others: Int64 = np.delete(np.arange(len(category), dtype=np.int64), row)
        for direction in (1.0, -1.0):
            mount = find_mount(name, float(size_m[row, 2]), is_front=direction > 0.0)
            box = camera_SE3_box[row : row + 1]
            end = None if mount is None else _project_end(camera, box, size_m[row], direction, mount, chosen, grow)
            if end is None or any(_is_expected(one, end) for one in plates):
                continue
            hidden = find_hidden(
                end.points.reshape(-1, 3), camera_SE3_box[others], size_m[others],
                [category[other] for other in others], margin_m=chosen.box_error_m,
            )  # fmt: skip
            if _is_seen(end.in_image & ~hidden.reshape(end.in_image.shape)):
                region = region_at(_at_height(end, plates).tolist(), "plate", score=0.0, source=SOURCE)
                strips.append(region.moved_to(region.box_px, "vehicle"))
    return strips


def _project_end(
    camera: Camera,
    camera_SE3_box: Poses,
    size_m: Float64,
    direction: float,
    mount: PlateMount,
    options: StripOptions,
    grow: float,
) -> _End | None:
    """One end of a vehicle; None: it faces away, is not in the image, or is too far to be read."""
    length, width, height = (float(value) for value in size_m)
    error = options.box_error_m
    half = min(mount.half_width_m, 0.5 * width)
    low, high = (min(level, height) - 0.5 * height for level in (mount.low_m, mount.high_m))
    middle, face = 0.5 * (low + high), 0.5 * direction * length
    outward = camera_SE3_box.transform(np.array([[face, 0.0, middle], [face + direction, 0.0, middle]]))[0]
    line = outward[0] / max(float(np.linalg.norm(outward[0])), 1e-9)
    cosine = float((outward[1] - outward[0]) @ -line)
    if cosine < _LEAST_COSINE:
        return None
    depths = (face + direction * error, face - direction * (_DEPTH_M + error))
    wide, tall = (half + error) / (1.0 + grow), (0.5 * (high - low) + error) / (1.0 + grow)
    plate, rise = 0.5 * _PLATE_M[0], 0.5 * _PLATE_M[1]
    columns = np.linspace(-plate, plate, _COLUMNS)
    rows = np.linspace(min(low + rise, middle), max(high - rise, middle), _ROWS)
    parts = (
        [(x, y, middle + z) for x in depths for y in (-wide, wide) for z in (-tall, tall)],
        [(face, y, middle + z) for y in (-plate, plate) for z in (-rise, rise)],
        [(face - 0.5 * direction * _DEPTH_M, y, z) for z in rows for y in columns],
    )
    strip, expected, places = (camera_SE3_box.transform(np.array(part))[0] for part in parts)
    strip_px, plate_px = _bounds(camera, strip), _bounds(camera, expected)
    if strip_px is None or plate_px is None or plate_px[2] - plate_px[0] < options.least_px:
        return None
    size = np.array([camera.width_px, camera.height_px], np.float64)
    inside = np.minimum(strip_px[2:], size) - np.maximum(strip_px[:2], 0.0)
    if (inside < 1.0).any():
        return None
    # Boxes that are wrong may show a plate that they have just outside of the image.
    beyond = error * (plate_px[2] - plate_px[0]) / _PLATE_M[0]
    uv = camera.project(places).uv_px
    in_image = ((uv >= -beyond) & (uv < size + beyond)).all(axis=1).reshape(_ROWS, _COLUMNS)
    return _End(strip_px, plate_px, places.reshape(_ROWS, _COLUMNS, 3), in_image) if _is_seen(in_image) else None


def _bounds(camera: Camera, points: Float64) -> Float64 | None:
    """Bounds (4,) of points (P, 3); None: the camera's model does not define all of them."""
    projected = camera.project(points)
    if not projected.defined.all():
        return None
    return np.concatenate([projected.uv_px.min(axis=0), projected.uv_px.max(axis=0)])


def _is_seen(seen: Bool) -> bool:
    """Return whether enough of a plate is seen at some height, from the places (R, C) that are."""
    return bool((seen.mean(axis=1) >= _LEAST_SEEN).any())


def _is_expected(region: Region, end: _End) -> bool:
    """Return whether a detected plate has the size, and the place across the vehicle, that its box lets expect."""
    left, top, right, bottom = end.plate_px
    held = min(region.right_px, right) - max(region.left_px, left), region.size_px[1]
    is_whole = held[0] >= _LEAST_HELD * (right - left) and held[1] >= _LEAST_HELD * (bottom - top)
    return bool(is_whole and _is_at_end(region, end))


def _is_at_end(region: Region, end: _End) -> bool:
    """Return whether a region may be a plate, or a part of one, at an end of a vehicle."""
    (u, v), (width, height) = region.centre_px, region.size_px
    largest = end.plate_px[2:] - end.plate_px[:2]
    return bool(
        end.strip_px[0] <= u <= end.strip_px[2]
        and end.strip_px[1] <= v <= end.strip_px[3]
        and width <= _WIDEST * largest[0]
        and _LOWEST * largest[1] <= height <= _TALLEST * largest[1]
    )


def _at_height(end: _End, plates: Sequence[Region]) -> Float64:
    """The strip (4,), only as high as a plate if a detector is sure of a part of one."""
    strip = end.strip_px.copy()
    heights = [one.centre_px[1] for one in plates if one.score >= _SURE and _is_at_end(one, end)]
    if heights:
        reach = end.plate_px[3] - end.plate_px[1]
        strip[1], strip[3] = max(strip[1], min(heights) - reach), min(strip[3], max(heights) + reach)
    return strip
