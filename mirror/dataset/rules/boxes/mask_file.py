"""MSK001."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.layer_files import missing_files
from mirror.dataset.check.rule import Cost, Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("MSK001", Severity.ERROR, cost=Cost.FILES, remedy="write the mask layer again")
def mask_file(view: SceneView) -> Iterator[Finding]:
    """A mask's file is missing, or has another size than its row says."""
    yield from missing_files(view, view.masks)
