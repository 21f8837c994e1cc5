"""LED003."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.check.dataset_view import DatasetView
from mirror.dataset.check.rule import Finding, Severity, dataset_rule
from mirror.dataset.rules.ledger.thresholds import figures

_TOLERANCE = 1e-6


@dataset_rule("LED003", Severity.ERROR, remedy="`mirror ingest RECORDING... --replace`")
def figures_agree(view: DatasetView) -> Iterator[Finding]:
    """A pass's figures contradict each other: its duration, path, overlap, or speed."""
    passes = view.passes
    found = figures(passes)
    span_s = (passes.integers("exit_ns") - passes.integers("entry_ns")) * 1e-9
    path, inside, overlap = found["path_m"], found["inside_path_m"], found["overlap"]
    wrong = {
        "a figure is not finite or negative": ~np.all([value >= 0 for value in found.values()], axis=0)
        | ~np.all([np.isfinite(value) for value in found.values()], axis=0),
        "duration_s is not exit_ns - entry_ns": np.abs(found["duration_s"] - span_s) > _TOLERANCE,
        "overlap is not from 0 to 1": ~((overlap >= 0) & (overlap <= 1)),
        "inside_path_m is more than path_m": inside > path * (1 + _TOLERANCE) + _TOLERANCE,
        "overlap is not inside_path_m / path_m": (path > 0) & (np.abs(overlap - inside / path) > _TOLERANCE),
        "mean_speed_mps is not path_m / duration_s": (span_s > 0)
        & (np.abs(found["mean_speed_mps"] - path / span_s) > _TOLERANCE * (1 + path / span_s)),
    }
    bad = np.any(list(wrong.values()), axis=0)
    yield from passes.findings(bad, lambda row: "; ".join(text for text, where in wrong.items() if where[row]))
