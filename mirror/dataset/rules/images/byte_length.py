"""IMG002."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Cost, Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule(
    "IMG002", Severity.ERROR, cost=Cost.FILES, remedy="restore the file from the recording, or ingest the drive again"
)
def byte_length(view: SceneView) -> Iterator[Finding]:
    """A picture's file is shorter than its bytes, or, where it holds nothing else, longer."""
    images, size = view.all_images, view.picture_files.size
    offset, length = images.integers("byte_offset"), images.integers("byte_length")
    codes, words = images.words("codec")
    still = ~np.isin(codes, [code for code, word in enumerate(words) if word == "video"])
    # Pictures that lie one behind the other in a shard have a uri in common.
    uri = images.words("uri")[0]
    alone = (np.bincount(uri, minlength=1)[uri] == 1) | ~still
    short = (size >= 0) & ((size < offset + length) | (alone & (offset == 0) & (size != length)))
    yield from images.findings(
        short, lambda row: f"{images.word('uri', row)} has {size[row]} bytes; expected {offset[row] + length[row]}"
    )
