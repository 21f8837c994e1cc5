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
        own = np.flatnonzero(frames.framed[rows]) + rows.start
        count = int(index[own].max()) + 1 if len(own) else 0
        for camera in np.unique(cameras[own]).tolist() if count > 2 else ():
            present = np.zeros(count, np.bool_)
            present[index[own[cameras[own] == camera]]] = True
            missing = np.flatnonzero(~present[1:-1]) + 1
            if len(missing):
                yield Finding(
                    file,
                    f"camera {names[camera]}, frame {missing[0]}",
                    f"no picture in {len(missing)} of {count} frames",
                    len(missing),
                )
