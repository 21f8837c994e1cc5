"""CAM012."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "CAM012",
    Severity.WARNING,
    remedy="look for the camera's pictures in the recording, and `mirror ingest RECORDING... --replace`",
)
def silent_camera(view: SceneView) -> Iterator[Finding]:
    """A camera of the rig has no picture in a traversal that has pictures of others."""
    images = view.images
    cameras, names = images.words("camera")
    for file, number, rows in images.slices():
        rig = view.traversals[number].rig
        there = {names[code] for code in np.unique(cameras[rows]).tolist()}
        silent = (
            [camera.name for camera in rig.cameras if camera.name not in there] if rig is not None and there else []
        )
        if silent:
            yield Finding(file, f"camera {silent[0]}", f"no picture of {', '.join(silent)}", len(silent))
