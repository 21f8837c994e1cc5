"""POS010."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "POS010",
    Severity.ERROR,
    remedy="`mirror ingest RECORDING... --replace`: a picture without a pose does not belong to a pass",
)
def cover_pictures(view: SceneView) -> Iterator[Finding]:
    """A picture lies before the first or behind the last pose of its traversal."""
    first, last = view.pose_span()
    stamps = view.images.integers("timestamp_ns")
    number = view.images.traversal
    # Where the table of poses cannot be read, another rule says so.
    read = np.isin(number, [traversal for _, traversal, _ in view.poses.parts])
    outside_s = np.maximum(first[number] * 1e-9 - stamps * 1e-9, stamps * 1e-9 - last[number] * 1e-9)
    yield from view.images.findings(
        read & ((stamps < first[number]) | (stamps > last[number])),
        lambda row: (
            f"{outside_s[row]:.3f} s outside the poses, {first[number[row]]} to {last[number[row]]}"
            if first[number[row]] <= last[number[row]]
            else "the traversal has no poses"
        ),
        worst=outside_s,
    )
