"""The redaction layer of a traversal: which one replaces the recorded images, and its hash for derived data."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

from mirror.dataset.layout import MANIFEST, Layout
from mirror.schema.documents import Manifest
from mirror.schema.files import read_json

REDACTION: Final = "redaction"
"""Kind of the layers, and the key under which derived layers record the hash of the one that they come from."""


def newest_redaction(layers: Iterable[tuple[str, str, str]]) -> tuple[str, str] | None:
    """Return the newest redaction layer, which replaces the recorded images; None if there is none.

    Args:
        layers: kind, source and version of a traversal's layers.

    Returns:
        Source and version.
    """
    found = [(source, version) for kind, source, version in layers if kind == REDACTION]
    return max(found, key=lambda layer: (_natural(layer[1]), layer[0]), default=None)


def current_redaction(layout: Layout, traversal_id: str) -> str | None:
    """Return the hash of the contents of a traversal's newest redaction layer; None without such a layer.

    Raises:
        SchemaError: the layer's manifest is broken.
    """
    newest = newest_redaction(layout.layers(traversal_id))
    if newest is None:
        return None
    return read_json(layout.layer(traversal_id, REDACTION, *newest) / MANIFEST, Manifest).content


def _natural(version: str) -> tuple[tuple[int, int, str], ...]:
    """A sort key of versions that puts version 10 after version 9."""
    return tuple((1, int(part), "") if part.isdigit() else (0, 0, part) for part in re.findall(r"\d+|\D+", version))
