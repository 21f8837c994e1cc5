"""MSK001."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mirror.dataset.check.pictures import leads_out
from mirror.dataset.check.rule import Cost, Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("MSK001", Severity.ERROR, cost=Cost.FILES, remedy="write the mask layer again")
def mask_file(view: SceneView) -> Iterator[Finding]:
    """A mask's file is missing, or has another size than its row says."""
    masks = view.masks
    length = masks.integers("byte_length")
    size = np.array([_size(view, uri) for uri in masks.data.column("uri").to_pylist()], np.int64)
    yield from masks.findings(
        size != length,
        lambda row: (
            f"{masks.word('uri', row)} "
            + ("is missing" if size[row] < 0 else f"has {size[row]} bytes; expected {length[row]}")
        ),
    )


def _size(view: SceneView, uri: str) -> int:
    place = None if leads_out(uri) else view.dataset.store.resolve(uri)
    return place.stat().st_size if isinstance(place, Path) and place.is_file() else -1
