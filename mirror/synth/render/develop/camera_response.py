"""How one camera renders what another renders a little otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class CameraResponse:
    """The character of one camera of one vehicle.

    Attributes:
        exposure_ev: how much brighter it exposes than others, in powers of two.
        tint: gains of red, green and blue on top of the white balance that all have.
        vignette: how much light the corners lose: they get ``1 / (1 + vignette)**2`` of it.
        noise: standard deviation of its noise, in those of the condition.
    """

    exposure_ev: float = 0.0
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    vignette: float = 0.0
    noise: float = 1.0


def draw_camera_response(seed: int | Sequence[int]) -> CameraResponse:
    """The character of the camera that a seed stands for."""
    rng = np.random.default_rng(seed)
    warm, green = rng.normal(0.0, 0.022), rng.normal(0.0, 0.010)
    return CameraResponse(
        exposure_ev=float(rng.normal(0.0, 0.12)),
        tint=(float(1.0 + warm), float(1.0 + green), float(1.0 - warm)),
        vignette=float(rng.uniform(0.10, 0.30)),
        noise=float(rng.uniform(0.8, 1.3)),
    )
