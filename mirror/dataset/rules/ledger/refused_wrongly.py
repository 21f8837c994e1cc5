"""LED002."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule
from mirror.dataset.rules.ledger.thresholds import accepted, thresholds


@dataset_rule(
    "LED002",
    Severity.ERROR,
    remedy="`mirror ingest RECORDING... --replace`: its ledger was written with other thresholds",
)
def refused_wrongly(view: DatasetView) -> Iterator[Finding]:
    """A refused pass names another rule, figure or threshold than the first of the trigger's that it fails."""
    if view.document is None:
        return
    passes = view.passes
    codes, words = passes.words("rule")
    refused = ~accepted(passes)
    expected = np.full(len(passes), "none", dtype=object)
    right = np.zeros(len(passes), np.bool_)
    undecided = refused.copy()
    for threshold in thresholds(view.document.trigger):
        fails = undecided & ~threshold.met(passes)
        named = np.isin(codes, [code for code, word in enumerate(words) if word == threshold.rule])
        same_figure = passes.floats("measured") == passes.floats(threshold.column)
        right |= fails & named & same_figure & (passes.floats("threshold") == threshold.limit)
        expected[fails] = f"{threshold.rule}: {threshold}"
        undecided &= ~fails
    yield from passes.findings(
        refused & ~right,
        lambda row: (
            f"refused by {passes.word('rule', row)}, measured {passes.floats('measured')[row]:g}, threshold"
            f" {passes.floats('threshold')[row]:g}; the first that it fails is {expected[row]}"
        ),
    )
