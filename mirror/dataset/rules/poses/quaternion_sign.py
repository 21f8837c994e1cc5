"""POS004."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("POS004", Severity.WARNING, remedy="change the sign of all four components, and write the table again")
def quaternion_sign(view: SceneView) -> Iterator[Finding]:
    """A pose's quaternion has a negative scalar part: the same rotation, but not in its canonical form."""
    scalar = view.all_poses.floats("qw")
    yield from view.all_poses.findings(scalar < 0, lambda row: f"qw is {scalar[row]:.9g}; expected at least 0")
