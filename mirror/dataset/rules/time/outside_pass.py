"""TIM009."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("TIM009", Severity.ERROR, remedy="`mirror ingest RECORDING... --replace`")
def outside_pass(view: SceneView) -> Iterator[Finding]:
    """A picture was taken before the entry or after the exit of its pass."""
    images = view.images
    stamps = images.integers("timestamp_ns")
    entry, end = view.entry_ns[images.traversal], view.exit_ns[images.traversal]
    outside_s = np.maximum(entry * 1e-9 - stamps * 1e-9, stamps * 1e-9 - end * 1e-9)
    yield from images.findings(
        (stamps < entry) | (stamps > end),
        lambda row: f"{outside_s[row]:.3f} s outside the pass, {entry[row]} to {end[row]}",
        worst=outside_s,
    )
