"""IMG008."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView
from mirror.dataset.splits.candidates import hash_bytes


@scene_rule(
    "IMG008", Severity.WARNING, remedy="look whether the camera froze; drop the repeated pictures in the recording"
)
def repeated_picture(view: SceneView) -> Iterator[Finding]:
    """Two pictures of one camera and traversal have the same bytes: a frozen camera."""
    images = view.images
    rows = np.flatnonzero(images.known("sha256"))
    hashes = hash_bytes(images.data.column("sha256"))
    words = np.ascontiguousarray(hashes).view(np.uint64)
    camera = images.words("camera")[0]
    keys = (*words.T, camera[rows], images.owner[rows])
    # The rows of equal keys lie together, the first one first.
    order = np.lexsort((rows, *keys))
    same = np.all([key[order][1:] == key[order][:-1] for key in keys], axis=0) if len(rows) else np.empty(0, np.bool_)
    bad = np.zeros(len(images), np.bool_)
    bad[rows[order[1:][same]]] = True
    yield from images.findings(bad, lambda row: "the bytes of an earlier picture of this camera")
