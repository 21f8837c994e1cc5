"""TIM004."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "TIM004", Severity.ERROR, remedy="`mirror ingest RECORDING... --replace`: its frames were put together wrongly"
)
def frame_numbers(view: SceneView) -> Iterator[Finding]:
    """Frames do not count from 0 along the reference camera, or one has two pictures of a camera, or none of it."""
    images = view.images
    if not len(images):
        return
    frames = view.frames
    index = images.integers("frame_index")
    known = images.known("frame_index")
    same = images.same_group("camera")
    expected = np.arange(len(images)) - np.maximum.accumulate(np.where(same, 0, np.arange(len(images))))
    miscounted = frames.is_reference & ~(known & (index == expected))
    yield from images.findings(
        miscounted,
        lambda row: (
            f"picture {expected[row]} of the reference camera has frame_index {index[row] if known[row] else 'null'}"
        ),
    )
    order = np.lexsort((index, images.words("camera")[0], images.owner))
    again = (
        (np.diff(index[order]) == 0)
        & (np.diff(images.words("camera")[0][order]) == 0)
        & (np.diff(images.owner[order]) == 0)
        & known[order][1:]
        & known[order][:-1]
    )
    repeated = np.zeros(len(images), np.bool_)
    repeated[order[1:][again]] = True
    lost = known & ~frames.framed & frames.has_reference[images.traversal]
    yield from images.findings(
        (repeated | lost) & ~miscounted & ~frames.is_reference,
        lambda row: f"frame {index[row]} has {'another picture of the camera' if repeated[row] else 'no reference'}",
    )
