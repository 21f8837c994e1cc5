"""CAM007."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView

_TOLERANCE = 1e-9


@scene_rule(
    "CAM007",
    Severity.ERROR,
    remedy="correct the calibration in the recording, and `mirror ingest RECORDING... --replace`",
)
def covariance(view: SceneView) -> Iterator[Finding]:
    """A mounting's covariance is not a 6x6 matrix that is symmetric and has no negative eigenvalue."""
    rows = view.all_calibrations
    why: dict[int, str] = {}
    for row in np.flatnonzero(rows.known("covariance")).tolist():
        values = np.array(rows.data.column("covariance")[row].as_py(), np.float64)
        if values.shape != (36,) or not np.isfinite(values).all():
            why[row] = f"{len(values)} values, {np.isfinite(values).sum()} of them finite; expected 36"
            continue
        matrix = values.reshape(6, 6)
        scale = np.abs(matrix).max()
        lowest = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))[0]
        if np.abs(matrix - matrix.T).max() > _TOLERANCE * scale:
            why[row] = "not symmetric"
        elif lowest < -_TOLERANCE * scale:
            why[row] = f"smallest eigenvalue {lowest:.3g}; expected at least 0"
    bad = np.zeros(len(rows), np.bool_)
    bad[list(why)] = True
    yield from rows.findings(bad, lambda row: why[row])
