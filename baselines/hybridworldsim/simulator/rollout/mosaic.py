"""All images of an instant as one, with a bird's-eye view beside them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import cv2
import numpy as np

from hybridworldsim.simulator.ego.vehicle import center_position
from hybridworldsim.simulator.renderers.boxes import COLOURS
from hybridworldsim.simulator.simulation import Simulation
from hybridworldsim.simulator.street.obstacles import corners_of
from mirror.arrays import Float64, UInt8

SIDE_PX: Final = 270
_VIEW_M: Final = 70.0
_AHEAD: Final = 0.3
_OUTSIDE: Final = (223, 226, 220)
_DRIVABLE: Final = (178, 180, 182)
_LANE: Final = (240, 240, 240)
_ROUTE: Final = (90, 170, 240)
_EGO: Final = (20, 120, 60)
_OTHER: Final = (90, 90, 90)
_SHIFT: Final = 4


def bird_eye(simulation: Simulation, side_px: int = SIDE_PX) -> UInt8:
    """Draw the surroundings of the ego from above, (side_px, side_px, 3) RGB; the ego's heading points up."""
    now, street = simulation.now, simulation.street
    scale = side_px / _VIEW_M
    cos, sin = math.cos(now.ego.yaw_rad), math.sin(now.ego.yaw_rad)
    origin = np.array(center_position(now.vehicle, now.ego))

    def pixels(points_m: Float64) -> np.ndarray:
        offset = points_m[:, :2] - origin
        ahead, left = offset @ (cos, sin), offset @ (-sin, cos)
        u = 0.5 * side_px - scale * left
        v = (0.5 + _AHEAD) * side_px - scale * ahead
        return np.round(np.clip(np.column_stack([u, v]), -1e4, 1e4) * (1 << _SHIFT)).astype(np.int32)

    image: UInt8 = np.full((side_px, side_px, 3), _OUTSIDE, np.uint8)
    rings = [pixels(ring) for ring in street.road_map.drivable_rings]
    if rings:
        cv2.fillPoly(image, rings, _DRIVABLE, cv2.LINE_8, _SHIFT)
    lanes = [pixels(lane.center_m) for lane in street.road_map.lanes_of()]
    cv2.polylines(image, lanes, False, _LANE, 1, cv2.LINE_AA, _SHIFT)
    cv2.polylines(image, [pixels(simulation.route.way.points)], False, _ROUTE, 2, cv2.LINE_AA, _SHIFT)
    for number, box in enumerate(now.boxes().states):
        if box[6]:
            category = "ego" if number == 0 else now.agents[number - 1].category
            colour = _EGO if number == 0 else COLOURS.get(category, _OTHER)
            cv2.fillConvexPoly(image, pixels(corners_of(box[[0, 1, 2, 4, 5]])), colour, cv2.LINE_AA, _SHIFT)
    return image


def mosaic(images: Mapping[str, UInt8], beside: UInt8) -> UInt8:
    """Arrange images in rows of up to three, with another image to the right of the rows, scaled to their height."""
    if not images:
        return beside
    height = max(image.shape[0] for image in images.values())
    width = max(image.shape[1] for image in images.values())
    across = min(3, len(images))
    down = -(-len(images) // across)
    sheet: UInt8 = np.zeros((down * height, across * width, 3), np.uint8)
    for number, image in enumerate(images.values()):
        top, left = number // across * height, number % across * width
        sheet[top : top + image.shape[0], left : left + image.shape[1]] = image
    side = down * height
    scaled = cv2.resize(beside, (side, side), interpolation=cv2.INTER_AREA if side < len(beside) else cv2.INTER_LINEAR)
    return np.concatenate([sheet, scaled], axis=1)
