"""IDX002."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule
from mirror.dataset.index.inputs import WHOLE


@dataset_rule("IDX002", Severity.ERROR, remedy="run `mirror index`")
def index_stale(view: DatasetView) -> Iterator[Finding]:
    """The index was derived from other inputs than those that are there."""
    inputs = view.index_inputs
    if view.index_manifest is None or inputs is None:
        return
    found = view.index_manifest.derived_from
    changed = [key for key in {**inputs.fingerprints, **found} if inputs.fingerprints.get(key) != found.get(key)]
    scenes = sorted(key for key in changed if key != WHOLE)
    if changed:
        yield Finding("index/manifest.json", "derived_from", f"stale: {', '.join(scenes) or 'drives'} changed since")
