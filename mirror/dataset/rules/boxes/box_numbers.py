"""BOX001."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.arrays import Bool
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("BOX001", Severity.ERROR, remedy="correct the boxes where they come from, and write the layer again")
def box_numbers(view: SceneView) -> Iterator[Finding]:
    """A box's number is NaN or infinite, or its length, width or height is not positive."""
    boxes = view.boxes
    size = np.column_stack([boxes.floats(name) for name in ("length_m", "width_m", "height_m")])
    pose = np.column_stack([boxes.floats(name) for name in ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")])
    bad: Bool = np.asarray(~((np.isfinite(size) & (size > 0)).all(axis=1) & np.isfinite(pose).all(axis=1)))
    for name in ("vx_mps", "vy_mps", "vz_mps"):
        bad |= boxes.known(name) & ~np.isfinite(boxes.floats(name))
    yield from boxes.findings(
        bad, lambda row: f"size {size[row].tolist()} m, centre {pose[row, 4:].tolist()} m, or a velocity"
    )
