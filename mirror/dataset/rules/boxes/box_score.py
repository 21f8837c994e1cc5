"""BOX006."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("BOX006", Severity.ERROR, remedy="write the layer again with scores from 0 to 1; null for a person's label")
def box_score(view: SceneView) -> Iterator[Finding]:
    """A box's score is not from 0 to 1."""
    score = view.boxes.floats("score")
    bad = view.boxes.known("score") & ~((score >= 0.0) & (score <= 1.0))
    yield from view.boxes.findings(np.asarray(bad), lambda row: f"score {score[row]:g}")
