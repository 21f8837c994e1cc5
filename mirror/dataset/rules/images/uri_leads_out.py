"""IMG010."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pyarrow.compute as pc

from mirror.dataset.check.pictures import leads_out
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView


@scene_rule("IMG010", Severity.ERROR, remedy="do not use this dataset: its tables have been tampered with")
def uri_leads_out(view: SceneView) -> Iterator[Finding]:
    """The uri of a picture or mask leads out of the dataset's folder."""
    for rows in (view.all_images, view.masks):
        # Nearly no uri has two dots in a row; only those that have are taken apart.
        suspects = np.flatnonzero(pc.match_substring(rows.data.column("uri"), "..").to_numpy())
        outside = np.zeros(len(rows), np.bool_)
        outside[suspects] = [leads_out(str(rows.word("uri", int(row)))) for row in suspects]
        yield from rows.findings(
            outside,
            lambda row, rows=rows: f"uri {rows.word('uri', row)!r}",  # type: ignore[misc]
        )
