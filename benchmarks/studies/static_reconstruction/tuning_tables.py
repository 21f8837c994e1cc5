"""Trials of the tuning as Markdown tables."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.studies.static_reconstruction.choices import (
    AS_TUNED,
    BASELINE_CHOICES,
    OWN_CHOICES,
    baseline_name,
    choice,
)
from benchmarks.studies.static_reconstruction.declaration import Tuning
from benchmarks.studies.static_reconstruction.methods import BASELINES, OURS, WIDER, trial
from benchmarks.studies.static_reconstruction.tables import JobResult


def grid_table(trials: Sequence[JobResult], grid: Tuning) -> str:
    """Format training PSNR and held-out PSNR* of each cell of the grid and method.

    The best sum of a method is bold.
    """
    methods = [OURS, *(baseline_name(package) for package in BASELINES)]
    cells = [(rates, sizes) for rates in grid.rates for sizes in grid.sizes]
    cells += dict.fromkeys(cell for wider in WIDER.values() for cell in wider)
    known = {one.job.entry: (one.figures["train PSNR"], one.figures["novel PSNR*"]) for one in trials}
    best = {
        name: max((sum(pair) for cell in cells if (pair := known.get(trial(name, *cell)))), default=None)
        for name in methods
    }  # fmt: skip
    lines = [f"| rates x, sizes x | {' | '.join(methods)} |", "|---" * (len(methods) + 1) + "|"]
    for cell in cells:
        pairs = [(name, known.get(trial(name, *cell))) for name in methods]
        texts = ["" if pair is None else f"{pair[0]:.2f} / {pair[1]:.2f}" for _, pair in pairs]
        marked = [
            f"**{text}**" if pair and sum(pair) == best[name] else text for text, (name, pair) in zip(texts, pairs)
        ]
        if any(texts):
            lines.append(f"| {cell[0]:g}, {cell[1]:g} | {' | '.join(marked)} |")
    return "\n".join(lines)


def choices_table(trials: Sequence[JobResult]) -> str:
    """Format the trials with one tuned choice changed, for baselines to the released one; empty without trials."""
    known = {one.job.entry: (one.figures["train PSNR"], one.figures["novel PSNR*"]) for one in trials}
    lines = ["| changed | training PSNR | minus tuned | PSNR* | minus tuned |", "|---|---|---|---|---|"]
    for method, changes in ((OURS, OWN_CHOICES), *BASELINE_CHOICES.items()):
        tuned_ones = known.get(choice(method, AS_TUNED))
        for name in changes:
            own = known.get(choice(method, name))
            if own is not None and tuned_ones is not None:
                both = " | ".join(f"{value:.2f} | {value - base:+.2f}" for value, base in zip(own, tuned_ones))
                lines.append(f"| {choice(method, name)} | {both} |")
    return "\n".join(lines) if len(lines) > 2 else ""
