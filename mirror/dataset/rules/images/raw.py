"""IMG009."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("IMG009", Severity.INFO, remedy="de-identify the dataset before it is passed on")
def raw(view: SceneView) -> Iterator[Finding]:
    """Pictures show faces and plates as recorded: they are raw, and no redaction layer replaces them."""
    images = view.images
    codes, words = images.words("privacy")
    redacted = {
        number for number, item in enumerate(view.traversals) if any(kind == "redaction" for kind, *_ in item.layers)
    }
    is_raw = np.isin(codes, [code for code, word in enumerate(words) if word == "raw"])
    yield from images.findings(is_raw & ~np.isin(images.traversal, list(redacted)), lambda row: "privacy is raw")
