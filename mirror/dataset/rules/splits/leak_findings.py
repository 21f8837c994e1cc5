"""Findings of leaks of one kind, over all splits."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding
from mirror.dataset.splits.leaks import TieKind, leaks
from mirror.schema.documents import ByScene


def leak_findings(view: DatasetView, *kinds: TieKind) -> Iterator[Finding]:
    """A finding for each split with such a leak: the first, and how many there are.

    Scenes and their ground count only in splits by scene: in the others all traversals of a scene share it.
    """
    for name, split in view.splits.items():
        wanted = [kind for kind in kinds if kind not in ("scene", "area") or isinstance(split.parameters, ByScene)]
        found = leaks((tie for tie in view.ties if tie.kind in wanted), split.assignments)
        if found:
            yield Finding(f"splits/{name}.json", f"{found[0].first}, {found[0].second}", str(found[0]), len(found))
