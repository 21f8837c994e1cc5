"""IMG005."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.rule import Cost, Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "IMG005", Severity.ERROR, cost=Cost.PICTURES, remedy="restore the file from the recording, or drop the picture"
)
def undecodable(view: SceneView) -> Iterator[Finding]:
    """A picture whose end is there cannot be decoded."""
    images = view.all_images
    yield from images.findings(
        ~view.picture_contents.decodes & view.picture_files.ended,
        lambda row: f"{images.word('uri', row)} cannot be decoded as {images.word('codec', row)}",
    )
