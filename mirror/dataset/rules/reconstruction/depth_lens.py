"""DEP004."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("DEP004", Severity.ERROR, remedy="write the depth layer again, with the raster and lens of its maps")
def depth_lens(view: SceneView) -> Iterator[Finding]:
    """A depth map has no raster, or no pinhole: a focal length is not positive, or a number not finite."""
    rows = view.depth
    lens = np.stack([rows.floats(name) for name in ("fx_px", "fy_px", "cx_px", "cy_px")], axis=1)
    bad = ~np.isfinite(lens).all(axis=1) | ~(lens[:, :2] > 0.0).all(axis=1)
    bad |= (rows.integers("width_px") <= 0) | (rows.integers("height_px") <= 0)
    yield from rows.findings(
        bad,
        lambda row: (
            f"{rows.integers('width_px')[row]} x {rows.integers('height_px')[row]} px, lens {lens[row].tolist()}"
        ),
    )
