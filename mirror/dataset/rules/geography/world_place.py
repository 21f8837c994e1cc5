"""GEO001."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView
from mirror.geometry.geodesy import TangentFrame

_TOLERANCE_M = 0.01


@scene_rule("GEO001", Severity.ERROR, remedy="`mirror ingest RECORDING... --replace`: both columns come from one fix")
def world_place(view: SceneView) -> Iterator[Finding]:
    """A recorded pose's place in the world is not the one of its longitude and latitude."""
    scene, poses = view.scene, view.poses
    if scene.longitude_deg is None or scene.latitude_deg is None or not len(poses):
        return
    # Where the source has no height, the scene's stands in for it.
    height = np.where(poses.known("height_m"), poses.floats("height_m"), scene.height_m)
    frame = TangentFrame(scene.longitude_deg, scene.latitude_deg, scene.height_m)
    expected = frame.from_geodetic(poses.floats("longitude_deg"), poses.floats("latitude_deg"), height)
    world = np.column_stack([poses.floats(name) for name in ("tx_m", "ty_m", "tz_m")])
    off = np.linalg.norm(world - expected, axis=1)
    yield from poses.findings(
        off > _TOLERANCE_M,
        lambda row: f"{off[row]:.3f} m from where its longitude and latitude are; expected below {_TOLERANCE_M} m",
        worst=off,
    )
