"""TAB001."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.problems import unread
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("TAB001", Severity.ERROR, remedy="run the same `mirror ingest` again, or write the layer again")
def unreadable_table(view: SceneView) -> Iterator[Finding]:
    """A traversal's table cannot be read: cut short, of another schema version, a wrong column, or a null."""
    view.tables()
    own = tuple(f"traversals/{item.traversal_id}/" for item in view.traversals)
    yield from unread(view.dataset.problems, lambda file: file.endswith(".parquet") and file.startswith(own))
