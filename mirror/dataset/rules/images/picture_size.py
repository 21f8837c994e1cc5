"""IMG006."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.rule import Cost, Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "IMG006",
    Severity.ERROR,
    cost=Cost.PICTURES,
    remedy="`mirror ingest RECORDING... --replace`: the table states another size",
)
def picture_size(view: SceneView) -> Iterator[Finding]:
    """A decoded picture has another width or height than its row says."""
    images, found = view.all_images, view.picture_contents
    width, height = images.integers("width_px"), images.integers("height_px")
    decoded = found.width_px > 0
    yield from images.findings(
        decoded & ((found.width_px != width) | (found.height_px != height)),
        lambda row: (
            f"{images.word('uri', row)} is {found.width_px[row]} x {found.height_px[row]} px;"
            f" expected {width[row]} x {height[row]} px"
        ),
    )
