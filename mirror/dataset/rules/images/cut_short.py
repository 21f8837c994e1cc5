"""IMG003."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.rule import Cost, Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "IMG003", Severity.ERROR, cost=Cost.FILES, remedy="restore the file from the recording, or drop the picture"
)
def cut_short(view: SceneView) -> Iterator[Finding]:
    """A JPEG or PNG is cut short: its end marker is missing."""
    images = view.all_images
    yield from images.findings(
        ~view.picture_files.ended, lambda row: f"{images.word('uri', row)} has no end-of-image marker"
    )
