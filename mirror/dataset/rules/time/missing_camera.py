"""TIM006."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "TIM006", Severity.WARNING, remedy="nothing, if the pictures were not recorded: loaders give frames without them"
)
def missing_camera(view: SceneView) -> Iterator[Finding]:
    """Frames lack a camera that the traversal otherwise has; its first and last frame may."""
    images = view.images
    frames = view.frames
    cameras, names = images.words("camera")
    index = images.integers("frame_index")
    for file, _, rows in images.slices():
        framed = np.flatnonzero(frames.framed[rows]) + rows.start
        inner = np.unique(index[framed])[1:-1]
        for camera in np.unique(cameras[framed]).tolist():
            missing = np.setdiff1d(inner, index[framed[cameras[framed] == camera]])
            if len(missing):
                yield Finding(
                    file,
                    f"camera {names[camera]}, frame {missing[0]}",
                    f"no picture in {len(missing)} of {len(inner) + 2} frames",
                    len(missing),
                )
