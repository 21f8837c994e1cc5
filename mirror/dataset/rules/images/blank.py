"""IMG007."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.rule import Cost, Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView

_LEAST = 3


@scene_rule(
    "IMG007", Severity.WARNING, cost=Cost.PICTURES, remedy="look at the camera; drop the pictures if it was covered"
)
def blank(view: SceneView) -> Iterator[Finding]:
    """A picture is blank: all its pixels have the same value, or nearly."""
    images, spread = view.all_images, view.picture_contents.spread
    yield from images.findings(
        spread < _LEAST, lambda row: f"{images.word('uri', row)}: values differ by {spread[row]} of 255"
    )
