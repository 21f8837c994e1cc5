"""BOX004."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "BOX004",
    Severity.WARNING,
    remedy="let the track keep the category it has most often, in a new version of the layer",
)
def category_flip(view: SceneView) -> Iterator[Finding]:
    """A track changes its category."""
    boxes = view.boxes
    category, names = boxes.words("category")
    order = np.lexsort((boxes.integers("timestamp_ns"), boxes.words("track_id")[0], boxes.owner))
    bad = np.zeros(len(boxes), np.bool_)
    before = np.full(len(boxes), -1)
    before[order[1:]] = order[:-1]
    same = before >= 0
    for codes in (boxes.owner, boxes.words("track_id")[0]):
        same &= codes == codes[before]
    bad = same & (category != category[before])
    yield from boxes.findings(
        bad, lambda row: f"{names[category[row]]!r}, but {names[category[before[row]]]!r} one box before"
    )
