"""One camera of each model."""

from __future__ import annotations

import pytest

from mirror.geometry import Camera

PIXEL = {"width_px": 1920, "height_px": 1080, "cx_px": 955.3, "cy_px": 545.1}

CAMERAS = {
    "pinhole": Camera("pinhole", fx_px=1100.0, fy_px=1105.0, **PIXEL),
    "brown_conrady": Camera(
        "brown_conrady", fx_px=1100.0, fy_px=1105.0, **PIXEL, distortion=(-0.3, 0.1, 1e-3, -5e-4, -0.01)
    ),
    "rational": Camera(
        "rational", fx_px=1100.0, fy_px=1105.0, **PIXEL, distortion=(8.0, 3.0, 1e-3, -5e-4, 0.05, 8.3, 5.0, 0.3)
    ),
    "kannala_brandt": Camera(
        "kannala_brandt", fx_px=600.0, fy_px=601.0, **PIXEL, distortion=(0.05, -0.01, 0.003, -0.001)
    ),
    "f_theta": Camera("f_theta", fx_px=1.0, fy_px=1.0, **PIXEL, distortion=(0.0, 620.0, 3.0, -20.0, 2.0)),
}
each_model = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
