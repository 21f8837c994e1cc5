"""TIM007."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView

YEAR_2000_NS = 946_684_800_000_000_000
YEAR_2100_NS = 4_102_444_800_000_000_000


@scene_rule(
    "TIM007",
    Severity.ERROR,
    remedy="state the source's time base to the reader, and `mirror ingest RECORDING... --replace`",
)
def epoch(view: SceneView) -> Iterator[Finding]:
    """A stamp is not of the years 2000 to 2099: another time base, or a clock that was never set."""
    for rows in (view.all_poses, view.all_images, view.boxes, view.masks):
        stamps = rows.integers("timestamp_ns")
        yield from rows.findings(
            (stamps < YEAR_2000_NS) | (stamps >= YEAR_2100_NS),
            lambda row, stamps=stamps: f"{np.datetime64(int(stamps[row]), 'ns')}; expected 2000 to 2099",  # type: ignore[misc]
        )
