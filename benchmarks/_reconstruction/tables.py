"""Outcomes as tables: means over scenes and seeds, and paired differences to ours with their intervals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t

from benchmarks._reconstruction.declared import Tuning
from benchmarks._reconstruction.job import OUTCOMES, read_outcome
from benchmarks._reconstruction.methods import OURS, RIVALS, trial


@dataclass(frozen=True)
class Outcome:
    """What came of a job; `figures` by name."""

    entry: str
    scene: str
    seed: int
    core_minutes: float
    width_px: int
    figures: dict[str, float]


FIGURES = {
    "train PSNR": "dB",
    "train SSIM": "",
    "train ST-LPIPS": "",
    "novel PSNR": "dB",
    "novel PSNR*": "dB",
    "novel SSIM": "",
    "novel ST-LPIPS": "",
    "oracle PSNR*": "dB",
    "MB": "",
    "Gaussians": "",
    "steps": "",
}


def outcomes(folder: Path) -> list[Outcome]:
    """All that are of the declaration and of the settings as they are now."""
    read = map(read_outcome, sorted((folder / OUTCOMES).glob("*.json")))
    return [_outcome(document) for document in read if document is not None]


def _outcome(document: dict[str, Any]) -> Outcome:
    job, means = document["job"], document["means"]
    return Outcome(
        job["entry"],
        job["scene"],
        job["seed"],
        job["core_minutes"],
        job["width_px"],
        {
            "train PSNR": means["training"]["psnr"],
            "train SSIM": means["training"]["ssim"],
            "train ST-LPIPS": means["training"]["st_lpips"],
            "novel PSNR": means["novel"]["psnr"],
            "novel PSNR*": means["novel"]["psnr_cc"],
            "novel SSIM": means["novel"]["ssim"],
            "novel ST-LPIPS": means["novel"]["st_lpips"],
            "oracle PSNR*": document["oracle"]["psnr_cc"],
            "MB": document["model_bytes"] / 1e6,
            "Gaussians": document["gaussians"],
            "steps": document["steps"],
        },
    )


def table(found: Sequence[Outcome], entries: Iterable[str]) -> str:
    """Markdown: a row an entry, means over its outcomes, and of how many."""
    lines = [f"| method | {' | '.join(FIGURES)} | runs |", "|---" * (len(FIGURES) + 2) + "|"]
    for entry in entries:
        own = [one for one in found if one.entry == entry]
        if own:
            cells = [_cell(name, float(np.mean([one.figures[name] for one in own]))) for name in FIGURES]
            lines.append(f"| {entry} | {' | '.join(cells)} | {len(own)} |")
    return "\n".join(lines)


def differences(found: Sequence[Outcome], ours: str, entries: Iterable[str], names: Sequence[str]) -> str:
    """Markdown: one entry minus each other, paired by scene and seed, with 95 % intervals of Student's t."""
    lines = [f"| {ours} minus | {' | '.join(names)} | pairs |", "|---" * (len(names) + 2) + "|"]
    own = {(one.scene, one.seed): one for one in found if one.entry == ours}
    for entry in entries:
        pairs = [(own[key], one) for one in found if one.entry == entry and (key := (one.scene, one.seed)) in own]
        if entry == ours or not pairs:
            continue
        cells = []
        for name in names:
            gaps = np.array([mine.figures[name] - other.figures[name] for mine, other in pairs])
            low, high = interval(gaps)
            cells.append(f"{gaps.mean():+.3f} [{low:+.3f}, {high:+.3f}]")
        lines.append(f"| {entry} | {' | '.join(cells)} | {len(pairs)} |")
    return "\n".join(lines)


def tuned(found: Sequence[Outcome], grid: Tuning) -> str:
    """Markdown: of each method and cell of the grid training PSNR and PSNR*; the best sum of them is bold."""
    columns = list(product(grid.rates, grid.sizes))
    heads = [f"rates x {rates:g}, sizes x {sizes:g}" for rates, sizes in columns]
    lines = [f"| method | {' | '.join(heads)} |", "|---" * (len(heads) + 1) + "|"]
    known = {one.entry: (one.figures["train PSNR"], one.figures["novel PSNR*"]) for one in found}
    for name in (OURS, *(package.__name__ for package in RIVALS)):
        own = [known.get(trial(name, *column)) for column in columns]
        best = max((sum(pair) for pair in own if pair), default=None)
        cells = ["" if pair is None else f"{pair[0]:.2f} / {pair[1]:.2f}" for pair in own]
        marked = [f"**{cell}**" if pair and sum(pair) == best else cell for cell, pair in zip(cells, own)]
        lines.append(f"| {name} | {' | '.join(marked)} |")
    return "\n".join(lines)


def interval(gaps: np.ndarray, level: float = 0.95) -> tuple[float, float]:
    """Of the mean of paired differences; unbounded where there is one."""
    if len(gaps) < 2:
        return -np.inf, np.inf
    half = float(t.ppf(0.5 + level / 2.0, len(gaps) - 1) * gaps.std(ddof=1) / np.sqrt(len(gaps)))
    return float(gaps.mean()) - half, float(gaps.mean()) + half


def _cell(name: str, value: float) -> str:
    if name in ("Gaussians", "steps"):
        return f"{value:,.0f}"
    return f"{value:.3f}" if name.endswith(("SSIM", "LPIPS")) else f"{value:.2f}"
