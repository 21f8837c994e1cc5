"""IMG010."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.pictures import leads_out
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("IMG010", Severity.ERROR, remedy="do not use this dataset: its tables have been tampered with")
def uri_leads_out(view: SceneView) -> Iterator[Finding]:
    """The uri of a picture or mask leads out of the dataset's folder."""
    for rows in (view.all_images, view.masks):
        codes, words = rows.words("uri")
        outside = [code for code, word in enumerate(words) if leads_out(word)]
        yield from rows.findings(
            np.isin(codes, outside),
            lambda row, rows=rows: f"uri {rows.word('uri', row)!r}",  # type: ignore[misc]
        )
