"""IMG004."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.rule import Cost, Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "IMG004",
    Severity.ERROR,
    cost=Cost.PICTURES,
    remedy="restore the file from the recording, or `mirror ingest RECORDING... --replace`",
)
def picture_hash(view: SceneView) -> Iterator[Finding]:
    """A picture's bytes are not those that were recorded: another SHA-256."""
    images = view.all_images
    yield from images.findings(
        ~view.picture_contents.same_bytes, lambda row: f"{images.word('uri', row)} has other bytes than were recorded"
    )
