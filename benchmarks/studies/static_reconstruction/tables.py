"""Outcomes as tables: means over scenes and seeds, and paired differences to ours with their intervals."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import t

from benchmarks.studies.static_reconstruction.choices import AS_TUNED, CHOICES, OWN, choice, name_of
from benchmarks.studies.static_reconstruction.declared import Tuning
from benchmarks.studies.static_reconstruction.job import OUTCOMES, Job, read_outcome
from benchmarks.studies.static_reconstruction.methods import OURS, RIVALS, WIDER, entries, trial
from mirror.errors import DatasetError


@dataclass(frozen=True)
class Outcome:
    """What came of a job; `figures` by name."""

    job: Job
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
    "core min": "",
}


def outcomes(folder: Path) -> list[Outcome]:
    """All that are of the declaration and of the settings as they are now.

    Raises:
        DatasetError: they are of several datasets.
    """
    there = sorted((folder / OUTCOMES).glob("*.json"))
    found = [document for path in there if (document := read_outcome(path)) is not None]
    # A split of fewer traversals is of the same dataset.
    datasets = {document["dataset_hash"] for document in found}
    if len(datasets) > 1:
        raise DatasetError(
            f"outcomes of {len(datasets)} datasets", file=folder / OUTCOMES, expected="those of one",
            remedy="scenes that `prepare` made with other versions differ: run all jobs on the same ones",
        )  # fmt: skip
    return [_outcome(document) for document in found]


def _outcome(document: dict[str, Any]) -> Outcome:
    job, means = Job(**document["job"]), document["means"]
    # Training pictures of fewer traversals are others: nothing to compare.
    training = dict.fromkeys(means["training"], np.nan) if entries()[job.entry].split else means["training"]
    return Outcome(
        job,
        {
            "train PSNR": training["psnr"],
            "train SSIM": training["ssim"],
            "train ST-LPIPS": training["st_lpips"],
            "novel PSNR": means["novel"]["psnr"],
            "novel PSNR*": means["novel"]["psnr_cc"],
            "novel SSIM": means["novel"]["ssim"],
            "novel ST-LPIPS": means["novel"]["st_lpips"],
            "oracle PSNR*": document["oracle"]["psnr_cc"],
            "MB": document["model_bytes"] / 1e6,
            "Gaussians": document["gaussians"],
            "steps": document["steps"],
            "core min": document["core_s"] / 60.0,
        },
    )


def tables(found: Sequence[Outcome], rows: Sequence[str]) -> Iterator[str]:
    """Markdown: means, a row an entry.

    A mean of three scenes is no mean of one: where rows have different scenes and seeds there is a table of each
    such set, with all rows that have it whole.
    """
    keys = {entry: frozenset(map(_key, _of(found, entry))) for entry in rows}
    for common in sorted({own for own in keys.values() if own}, key=lambda one: (-len(one), sorted(one))):
        lines = [f"| method | {' | '.join(FIGURES)} | runs |", "|---" * (len(FIGURES) + 2) + "|"]
        for entry in (entry for entry in rows if keys[entry] >= common):
            own = [one for one in _of(found, entry) if _key(one) in common]
            cells = [_cell(name, float(np.mean([one.figures[name] for one in own]))) for name in FIGURES]
            lines.append(f"| {entry} | {' | '.join(cells)} | {len(own)} |")
        yield f"{_told(common)}\n\n" + "\n".join(lines)


def differences(found: Sequence[Outcome], ours: str, rows: Iterable[str], names: Sequence[str]) -> str:
    """Markdown: one entry minus each other, with 95 % intervals of Student's t.

    Paired by scene and seed, which tells how sure the difference is on these scenes; and by scene, of means over seeds,
    which tells what to expect of others.
    """
    lines = [f"| {ours} minus | {' | '.join(names)} | pairs |", "|---" * (len(names) + 2) + "|"]
    own = {_key(one): one for one in _of(found, ours)}
    for entry in rows:
        pairs = [(own[key], one) for one in _of(found, entry) if (key := _key(one)) in own]
        if entry == ours or not pairs:
            continue
        gaps = np.array([[mine.figures[name] - other.figures[name] for name in names] for mine, other in pairs])
        lines.append(f"| {entry} | {' | '.join(map(_gap, gaps.T))} | {len(gaps)} |")
        scenes = np.array([one.job.scene for _, one in pairs])
        of_scenes = np.array([gaps[scenes == scene].mean(0) for scene in np.unique(scenes)])
        if len(of_scenes) < len(gaps):
            lines.append(f"| {entry}, by scene | {' | '.join(map(_gap, of_scenes.T))} | {len(of_scenes)} |")
    return "\n".join(lines) if len(lines) > 2 else ""


def tuned(found: Sequence[Outcome], grid: Tuning) -> str:
    """Markdown: of each cell of the grid and method training PSNR and PSNR*; the best sum of a method is bold."""
    methods = [OURS, *(name_of(package) for package in RIVALS)]
    cells = [(rates, sizes) for rates in grid.rates for sizes in grid.sizes]
    cells += dict.fromkeys(cell for wider in WIDER.values() for cell in wider)
    known = {one.job.entry: (one.figures["train PSNR"], one.figures["novel PSNR*"]) for one in found}
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


def chosen(found: Sequence[Outcome]) -> str:
    """Markdown: the tuned settings with one choice each changed, those of rivals back to what was released."""
    known = {one.job.entry: (one.figures["train PSNR"], one.figures["novel PSNR*"]) for one in found}
    lines = ["| changed | training PSNR | minus tuned | PSNR* | minus tuned |", "|---|---|---|---|---|"]
    for method, changes in ((OURS, OWN), *CHOICES.items()):
        tuned_ones = known.get(choice(method, AS_TUNED))
        for name in changes:
            own = known.get(choice(method, name))
            if own is not None and tuned_ones is not None:
                both = " | ".join(f"{value:.2f} | {value - base:+.2f}" for value, base in zip(own, tuned_ones))
                lines.append(f"| {choice(method, name)} | {both} |")
    return "\n".join(lines) if len(lines) > 2 else ""


def _of(found: Sequence[Outcome], entry: str) -> list[Outcome]:
    return [one for one in found if one.job.entry == entry]


def _key(one: Outcome) -> tuple[str, int]:
    return one.job.scene, one.job.seed


def _told(keys: frozenset[tuple[str, int]]) -> str:
    """Which scenes and seeds a mean is of."""
    seeds: dict[tuple[int, ...], list[str]] = {}
    for scene in sorted({scene for scene, _ in keys}):
        seeds.setdefault(tuple(sorted(seed for one, seed in keys if one == scene)), []).append(scene)
    return "; ".join(
        f"{', '.join(scenes)}: seed{'s' if len(own) > 1 else ''} {', '.join(map(str, own))}"
        for own, scenes in seeds.items()
    )


def _gap(gaps: np.ndarray) -> str:
    if np.isnan(gaps).any():
        return "-"
    if len(gaps) < 2:
        return f"{gaps.mean():+.3f}"
    low, high = interval(gaps)
    return f"{gaps.mean():+.3f} [{low:+.3f}, {high:+.3f}]"


def interval(gaps: np.ndarray, level: float = 0.95) -> tuple[float, float]:
    """Of the mean of paired differences; unbounded where there is one."""
    if len(gaps) < 2:
        return -np.inf, np.inf
    half = float(t.ppf(0.5 + level / 2.0, len(gaps) - 1) * gaps.std(ddof=1) / np.sqrt(len(gaps)))
    return float(gaps.mean()) - half, float(gaps.mean()) + half


def _cell(name: str, value: float) -> str:
    if np.isnan(value):
        return "-"
    if name in ("Gaussians", "steps"):
        return f"{value:,.0f}"
    return f"{value:.3f}" if name.endswith(("SSIM", "LPIPS")) else f"{value:.2f}"
