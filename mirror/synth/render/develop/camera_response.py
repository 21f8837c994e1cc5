"""The response of a camera to light, which differs a little between cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class CameraResponse:
    """The response of one camera of one vehicle.

    Attributes:
        exposure_ev: exposure offset, in powers of two.
        tint: gains of red, green and blue, applied after the white balance.
        vignette: vignetting; the corners receive ``1 / (1 + vignette)**2`` of the light.
        noise: standard deviation of the noise, relative to that of the condition.
    """

    exposure_ev: float = 0.0
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    vignette: float = 0.0
    noise: float = 1.0


def draw_camera_response(seed: int | Sequence[int] | np.random.SeedSequence) -> CameraResponse:
    """Draw the response of a camera from a seed."""
    rng = np.random.default_rng(seed)
    warm, green = rng.normal(0.0, 0.022), rng.normal(0.0, 0.010)
    return CameraResponse(
        exposure_ev=float(rng.normal(0.0, 0.12)),
        tint=(float(1.0 + warm), float(1.0 + green), float(1.0 - warm)),
        vignette=float(rng.uniform(0.10, 0.30)),
        noise=float(rng.uniform(0.8, 1.3)),
    )
