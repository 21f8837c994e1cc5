"""LED001."""

from __future__ import annotations

from collections.abc import Iterator

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule
from mirror.dataset.rules.ledger.thresholds import accepted, thresholds


@dataset_rule(
    "LED001",
    Severity.ERROR,
    remedy="`mirror ingest RECORDING... --replace`: its ledger was written with other thresholds",
)
def accepted_too_early(view: DatasetView) -> Iterator[Finding]:
    """An accepted pass does not fulfil the trigger's thresholds in dataset.json."""
    if view.document is None:
        return
    passes = view.passes
    for threshold in thresholds(view.document.trigger):
        yield from passes.findings(
            accepted(passes) & ~threshold.met(passes),
            lambda row, threshold=threshold: (  # type: ignore[misc]
                f"{threshold.column} is {passes.floats(threshold.column)[row]:g}; expected {threshold}"
            ),
        )
