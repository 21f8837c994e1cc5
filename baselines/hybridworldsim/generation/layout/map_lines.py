"""Draws lanes, borders of the drivable area and crossings, where a map is known."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from hybridworldsim.generation.clips.map_lines import FARTHEST_M, LineKind, MapLine
from hybridworldsim.generation.layout.lines import draw_lines
from mirror.arrays import Float32, Float64

MAP_CHANNELS: Final = 3
"""Channels of the images: red, green and blue."""

_COLOURS: Final[dict[LineKind, tuple[float, float, float]]] = {
    "drivable": (0.0, 0.0, 1.0),
    "lane": (0.0, 1.0, 0.0),
    "crossing": (1.0, 0.0, 0.0),
}
_ORDER: Final[tuple[LineKind, ...]] = ("drivable", "lane", "crossing")


def draw_map(
    lines: Sequence[MapLine],
    ego_SE3_line: Float64,
    camera_SE3_ego: Float64,
    intrinsics: Float64,
    size_px: tuple[int, int],
    width_px: float,
) -> Float32:
    """Draw the lines near the vehicle: borders first, then lanes, then crossings.

    Args:
        lines: lines of the map.
        ego_SE3_line: (4, 4) pose of the frame of the lines.
        camera_SE3_ego: (4, 4).
        intrinsics: (3, 3) of the pinhole camera, pixels.
        size_px: height and width of the image.
        width_px: width of the lines.

    Returns:
        (3, height, width) from 0 to 1.

    Raises:
        UsageError: a point is not finite.
    """
    segments, colours = [np.zeros((0, 2, 3))], [np.zeros((0, 3))]
    for line in sorted(lines, key=lambda one: _ORDER.index(one.kind)):
        points = line.points_m @ ego_SE3_line[:3, :3].T + ego_SE3_line[:3, 3]
        pairs = np.stack([points[:-1], points[1:]], axis=1)
        # A segment with a point that is not finite is kept, so that it is refused.
        pairs = pairs[~(np.linalg.norm(pairs[..., :2], axis=-1).min(axis=1) > FARTHEST_M)]
        segments.append(pairs @ camera_SE3_ego[:3, :3].T + camera_SE3_ego[:3, 3])
        colours.append(np.tile(_COLOURS[line.kind], (len(pairs), 1)))
    return draw_lines(np.concatenate(segments), np.concatenate(colours), intrinsics, size_px, width_px)
