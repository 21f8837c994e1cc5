"""MSK003."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.layer_files import other_bytes
from mirror.dataset.check.rule import Cost, Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("MSK003", Severity.ERROR, cost=Cost.PICTURES, remedy="write the mask layer again")
def mask_hash(view: SceneView) -> Iterator[Finding]:
    """A mask's file has other bytes than were written: another SHA-256."""
    yield from other_bytes(view, view.masks)
