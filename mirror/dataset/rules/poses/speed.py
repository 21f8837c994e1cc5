"""POS006."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("POS006", Severity.WARNING, remedy="look at the fixes there; ingest again with a lower --max-speed-mps")
def speed(view: SceneView) -> Iterator[Finding]:
    """The vehicle jumps: faster from one pose to the next than cleaning allows (`max_speed_mps`)."""
    if view.dataset.document is None:
        return
    cleaning = view.dataset.document.cleaning
    motion = view.motion
    # What noise may do between two poses that are close in time is no speed.
    bad = motion.distance_m > cleaning.max_speed_mps * motion.step_s + cleaning.noise_m
    yield from view.all_poses.findings(
        bad,
        lambda row: (
            f"{motion.distance_m[row]:.2f} m in {motion.step_s[row]:.3f} s, {motion.speed_mps[row]:.1f} m/s;"
            f" expected at most {cleaning.max_speed_mps:g} m/s"
        ),
        worst=motion.speed_mps,
    )
