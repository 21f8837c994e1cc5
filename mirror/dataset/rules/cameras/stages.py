"""CAM010."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.motion import Motion
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView
from mirror.geometry.quaternions import angle_between_deg, quaternion_normalise

_LIMIT_DEG = 0.3


@scene_rule("CAM010", Severity.INFO, remedy="nothing, if the later stage is the better one; else measure both")
def stages(view: SceneView) -> Iterator[Finding]:
    """Calibration stages disagree about a camera's direction by more than 0.3 degrees, the paper's bound."""
    rows = view.calibrations
    mounted = Motion(rows)
    differ = np.zeros(len(rows), np.bool_)
    angle = np.zeros(len(rows))
    compared = rows.same_group("camera") & mounted.unit
    compared[1:] &= mounted.unit[:-1] & (rows.words("stage")[0][1:] != rows.words("stage")[0][:-1])
    at = np.flatnonzero(compared)
    if len(at):
        rotation = quaternion_normalise(mounted.rotation[np.concatenate([at, at - 1])])
        angle[at] = angle_between_deg(rotation[: len(at)], rotation[len(at) :])
        differ = angle > _LIMIT_DEG
    yield from rows.findings(
        differ,
        lambda row: f"{angle[row]:.3f} degrees from stage {rows.word('stage', row - 1)}",
        worst=angle,
    )
