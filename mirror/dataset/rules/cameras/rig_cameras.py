"""CAM011."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "CAM011",
    Severity.ERROR,
    remedy="add the camera to the rig in the recording, and `mirror ingest RECORDING... --replace`",
)
def rig_cameras(view: SceneView) -> Iterator[Finding]:
    """Pictures are of a camera that the rig of their drive does not have."""
    images = view.images
    cameras, names = images.words("camera")
    bad = np.zeros(len(images), np.bool_)
    for _, number, rows in images.slices():
        rig = view.traversals[number].rig
        if rig is not None:
            foreign = [code for code, name in enumerate(names) if name not in {camera.name for camera in rig.cameras}]
            bad[rows] = np.isin(cameras[rows], foreign)
        elif view.traversals[number].drive.rig_id is None:
            bad[rows] = True
    yield from images.findings(
        bad,
        lambda row: f"camera {names[cameras[row]]} is not in rig {view.traversals[images.traversal[row]].drive.rig_id}",
    )
