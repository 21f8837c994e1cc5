"""CAM008."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView

_MIN, _MAX = np.iinfo(np.int64).min, np.iinfo(np.int64).max


@scene_rule(
    "CAM008",
    Severity.ERROR,
    remedy="correct the intervals in the recording, and `mirror ingest RECORDING... --replace`",
)
def validity(view: SceneView) -> Iterator[Finding]:
    """Two calibrations of one camera and stage are valid at once, or one ends before it begins."""
    rows = view.all_calibrations
    start = np.where(rows.known("valid_from_ns"), rows.integers("valid_from_ns"), _MIN)
    end = np.where(rows.known("valid_to_ns"), rows.integers("valid_to_ns"), _MAX)
    order = np.lexsort((end, start, rows.words("stage")[0], rows.words("camera")[0], rows.owner))
    same = np.zeros(len(rows), np.bool_)
    same[order[1:]] = True
    for codes in (rows.owner, rows.words("camera")[0], rows.words("stage")[0]):
        same[order[1:]] &= codes[order[1:]] == codes[order[:-1]]
    # The last instant of one may be the first of the next.
    overlapping = np.zeros(len(rows), np.bool_)
    overlapping[order[1:]] = same[order[1:]] & (start[order[1:]] < end[order[:-1]])
    inverted = end < start
    yield from rows.findings(
        overlapping | inverted,
        lambda row: "ends before it begins" if inverted[row] else "begins before the one before it ends",
    )
