"""CAM004."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView

_FOCAL = (0.1, 20.0)
_ASPECT = 0.1
_CENTRE = 0.25


@scene_rule("CAM004", Severity.WARNING, remedy="check the calibration's units, and which raster it is for")
def implausible_lens(view: SceneView) -> Iterator[Finding]:
    """Intrinsics that no common lens has: focal length, its aspect, or the principal point far from the middle."""
    rows = view.all_calibrations
    width, height = rows.integers("width_px"), rows.integers("height_px")
    fx, fy, cx, cy = (rows.floats(name) for name in ("fx_px", "fy_px", "cx_px", "cy_px"))
    codes, words = rows.words("model")
    f_theta = np.isin(codes, [code for code, word in enumerate(words) if word == "f_theta"])
    share, aspect = fx / width, fy / fx
    off = np.maximum(np.abs(cx / width - 0.5), np.abs(cy / height - 0.5))
    lens = ~f_theta & ((share < _FOCAL[0]) | (share > _FOCAL[1]) | (np.abs(aspect - 1.0) > _ASPECT))
    sane = np.ones(len(rows), np.bool_)
    sane[list(view.camera_errors)] = False
    yield from rows.findings(
        sane & (lens | (off > _CENTRE)),
        lambda row: (
            f"fx {fx[row]:g}, fy {fy[row]:g}, cx {cx[row]:g}, cy {cy[row]:g} px of {width[row]} x {height[row]} px"
        ),
    )
