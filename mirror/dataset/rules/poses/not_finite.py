"""POS002."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pyarrow as pa

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView
from mirror.schema.tables import EGO_POSES

_NUMBERS = tuple(field.name for field in EGO_POSES.schema if pa.types.is_floating(field.type))
_LIMITS = {"longitude_deg": 180.0, "latitude_deg": 90.0}


@scene_rule(
    "POS002",
    Severity.ERROR,
    remedy="find out why the source has no such number there, and `mirror ingest RECORDING... --replace`",
)
def not_finite(view: SceneView) -> Iterator[Finding]:
    """A number of a pose is NaN or infinite, or its longitude or latitude is off the globe."""
    poses = view.all_poses
    bad = np.zeros(len(poses), np.bool_)
    for name in _NUMBERS:
        values = poses.floats(name)
        bad |= poses.known(name) & ~(np.isfinite(values) & (np.abs(values) <= _LIMITS.get(name, np.inf)))
    yield from poses.findings(bad, lambda row: ", ".join(f"{name} {poses.floats(name)[row]:.9g}" for name in _NUMBERS))
