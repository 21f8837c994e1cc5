"""MSK002."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.layer_files import lost_pictures
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("MSK002", Severity.ERROR, remedy="write the mask layer again, with the stamps of the images table")
def mask_picture(view: SceneView) -> Iterator[Finding]:
    """A mask is of a picture that was never recorded."""
    yield from lost_pictures(view, view.masks)
