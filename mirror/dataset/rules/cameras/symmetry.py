"""CAM009."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.motion import Motion
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView
from mirror.geometry.quaternions import quaternion_normalise, rotate

_PAIRS = (("front_left", "front_right"), ("rear_left", "rear_right"))
_PLACE_M = 0.5
_ANGLE_DEG = 15.0


@scene_rule(
    "CAM009", Severity.WARNING, remedy="check whether left and right are exchanged, or the mounting's frame is another"
)
def symmetry(view: SceneView) -> Iterator[Finding]:
    """A left and a right camera are not mirror images of each other, by over half a metre or 15 degrees."""
    rows = view.calibrations
    mounted = Motion(rows)
    cameras, names = rows.words("camera")
    stages = rows.words("stage")[0]
    usable = mounted.unit & np.isfinite(mounted.position).all(axis=1)
    for file, _, own in rows.slices():
        for left_name, right_name in _PAIRS:
            if left_name not in names or right_name not in names:
                continue
            index = np.arange(own.start, own.stop)[usable[own]]
            left = index[cameras[index] == names.index(left_name)]
            right = index[cameras[index] == names.index(right_name)]
            for one in left.tolist():
                other = right[stages[right] == stages[one]][:1].tolist()
                if other and (why := _difference(mounted, one, other[0])):
                    yield Finding(file, f"cameras {left_name} and {right_name}", why)
                    break


def _difference(mounted: Motion, left: int, right: int) -> str | None:
    """How a pair differs from being mirrored at the plane y = 0; None: it does not."""
    mirror = np.array([1.0, -1.0, 1.0])
    place = float(np.linalg.norm(mounted.position[left] - mirror * mounted.position[right]))
    axis = rotate(quaternion_normalise(mounted.rotation[[left, right]]), np.array([0.0, 0.0, 1.0]))
    cosine = float(np.clip(axis[0] @ (mirror * axis[1]), -1.0, 1.0))
    angle = float(np.degrees(np.arccos(cosine)))
    exchanged = mounted.position[left, 1] < mounted.position[right, 1]
    if place <= _PLACE_M and angle <= _ANGLE_DEG and not exchanged:
        return None
    return f"{place:.2f} m and {angle:.1f} degrees apart when one is mirrored" + (
        ", and the left one is right of the other" if exchanged else ""
    )
