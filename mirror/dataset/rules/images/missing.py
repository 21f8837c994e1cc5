"""IMG001."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.pictures import MISSING
from mirror.dataset.check.rule import Cost, Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "IMG001",
    Severity.ERROR,
    cost=Cost.FILES,
    remedy="restore the file from the recording, or `mirror ingest RECORDING... --replace`",
)
def missing(view: SceneView) -> Iterator[Finding]:
    """A picture's file is missing."""
    images = view.all_images
    yield from images.findings(
        view.picture_files.size == MISSING, lambda row: f"{images.word('uri', row)} is missing or cannot be opened"
    )
