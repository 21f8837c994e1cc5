"""The input of the renderer apart from the camera, as arrays for compiled kernels."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from mirror.arrays import Float32, Float64, Records

LAMP_CELL_M: Final = 1.0
AMBIENT_OCCLUSION_CELL_M: Final = 0.2
GLOW_CELL_M: Final = 0.5
GROUND_CELL_M: Final = 2.0

MAPS: Final = np.dtype(
    [
        ("sun_axes", np.float64, (2, 3)),
        ("static_shadow_origin", np.float64, 2),
        ("moving_shadow_origin", np.float64, 2),
        ("lamps_origin", np.float64, 2),
        ("glow_origin", np.float64, 2),
        ("ambient_occlusion_origin", np.float64, 2),
        ("ground_origin", np.float64, 2),
        ("beam", np.float64, 6),
    ]
)
"""The axes perpendicular to the sun's direction, the middle of the first cell of each map, and the position and
direction of the recording vehicle's headlights."""


class Surroundings(NamedTuple):
    """Everything besides the camera that determines an image.

    Attributes:
        faces: (F,) FACE, flat.
        corners: (C, 3).
        rounds: (R,) ROUND, flat.
        spheres: (F + R, 9) from `binning.bounding_spheres`.
        static_shadow: shadow map of what never moves.
        moving_shadow: shadow map of moving road users and the recording vehicle.
        lamps: (rows, columns) over the ground: light of the street lamps.
        glow: (rows, columns) over the ground: light of other vehicles' headlights.
        ambient_occlusion: (rows, columns) over the ground: share of the sky's light that road users keep from it.
        ground: (rows, columns) heights of the ground.
        dome: radiance of the clear sky.
        clouds: density of the clouds.
        layouts: (L, K) MARK, flat: markings of carriageways.
        setting: LIGHTING record, flat.
        maps: MAPS record, flat.
    """

    faces: Records
    corners: Float64
    rounds: Records
    spheres: Float64
    static_shadow: Float32
    moving_shadow: Float32
    lamps: Float32
    glow: Float32
    ambient_occlusion: Float32
    ground: Float32
    dome: Float32
    clouds: Float32
    layouts: Records
    setting: Records
    maps: Records
