"""Outcomes as Markdown tables: means over scenes and seeds, and paired differences with their intervals."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import t

from benchmarks.studies.static_reconstruction.jobs import Job
from benchmarks.studies.static_reconstruction.methods import entries
from benchmarks.studies.static_reconstruction.records import Document
from mirror.errors import DatasetError


@dataclass(frozen=True)
class JobResult:
    """The figures of one job.

    Attributes:
        job: that was run.
        figures: by name, see `FIGURES`; NaN where a figure does not compare.
    """

    job: Job
    figures: dict[str, float]


FIGURES: Final = (
    "train PSNR", "train SSIM", "train ST-LPIPS", "novel PSNR", "novel PSNR*", "novel SSIM", "novel ST-LPIPS",
    "oracle PSNR*", "MB", "Gaussians", "steps", "core min",
)  # fmt: skip
"""PSNR in dB; `train` of training images, `novel` of held-out ones in the declared appearance."""
COMPARED: Final = ("train PSNR", "train SSIM", "train ST-LPIPS", "novel PSNR*", "novel SSIM", "novel ST-LPIPS")
"""Figures whose differences are shown."""


def read_results(outcomes: Sequence[Document]) -> list[JobResult]:
    """Return the figures of outcomes.

    Raises:
        DatasetError: the outcomes are of several datasets.
    """
    # A split of fewer traversals is of the same dataset.
    datasets = {outcome["dataset_hash"] for outcome in outcomes}
    if len(datasets) > 1:
        raise DatasetError(
            f"outcomes of {len(datasets)} datasets", expected="outcomes of one",
            remedy="scenes that `prepare` made with other versions differ: run all jobs on the same ones",
        )  # fmt: skip
    return [_result(outcome) for outcome in outcomes]


def _result(outcome: Document) -> JobResult:
    job, means = Job(**outcome["job"]), outcome["means"]
    # A row with fewer training traversals has other training images: nothing to compare.
    training = dict.fromkeys(means["training"], np.nan) if entries()[job.entry].split else means["training"]
    return JobResult(
        job,
        {
            "train PSNR": training["psnr"],
            "train SSIM": training["ssim"],
            "train ST-LPIPS": training["st_lpips"],
            "novel PSNR": means["novel"]["psnr"],
            "novel PSNR*": means["novel"]["psnr_cc"],
            "novel SSIM": means["novel"]["ssim"],
            "novel ST-LPIPS": means["novel"]["st_lpips"],
            "oracle PSNR*": outcome["oracle"]["psnr_cc"],
            "MB": outcome["model_bytes"] / 1e6,
            "Gaussians": outcome["gaussians"],
            "steps": outcome["steps"],
            "core min": outcome["core_s"] / 60.0,
        },
    )


def mean_tables(results: Sequence[JobResult], rows: Sequence[str]) -> Iterator[str]:
    """Yield the tables of means, a row for each entry.

    A mean of three scenes and a mean of one do not compare: where rows have different scenes and seeds, each such set
    has a table, with all rows that have results of the whole set.
    """
    runs = {entry: frozenset(map(_run, _of(results, entry))) for entry in rows}
    for common in sorted({own for own in runs.values() if own}, key=lambda one: (-len(one), sorted(one))):
        lines = [f"| method | {' | '.join(FIGURES)} | runs |", "|---" * (len(FIGURES) + 2) + "|"]
        for entry in (entry for entry in rows if runs[entry] >= common):
            own = [one for one in _of(results, entry) if _run(one) in common]
            cells = [_cell(name, float(np.mean([one.figures[name] for one in own]))) for name in FIGURES]
            lines.append(f"| {entry} | {' | '.join(cells)} | {len(own)} |")
        yield f"{_describe(common)}\n\n" + "\n".join(lines)


def differences_table(results: Sequence[JobResult], entry: str, others: Iterable[str], names: Sequence[str]) -> str:
    """Return the table of one entry minus each other, with 95 % intervals of Student's t; empty if nothing compares.

    Pairs of the same scene and seed say how sure a difference is on these scenes. Means over seeds, paired by scene,
    say what to expect of other scenes.
    """
    lines = [f"| {entry} minus | {' | '.join(names)} | pairs |", "|---" * (len(names) + 2) + "|"]
    for other in others:
        if other == entry:
            continue
        by_run, by_scene = (paired_differences(results, entry, other, names, by_scene=by) for by in (False, True))
        if len(by_run):
            lines.append(f"| {other} | {' | '.join(map(_difference, by_run.T))} | {len(by_run)} |")
        if len(by_scene) < len(by_run):
            lines.append(f"| {other}, by scene | {' | '.join(map(_difference, by_scene.T))} | {len(by_scene)} |")
    return "\n".join(lines) if len(lines) > 2 else ""


def paired_differences(
    results: Sequence[JobResult], entry: str, other: str, names: Sequence[str], *, by_scene: bool
) -> np.ndarray:
    """Return the differences (N, F) of figures between two entries.

    They are of each scene and seed, or of each scene's mean over seeds.
    """
    own = {_run(one): one for one in _of(results, entry)}
    pairs = [(own[_run(one)], one) for one in _of(results, other) if _run(one) in own]
    gaps = np.array([[mine.figures[name] - one.figures[name] for name in names] for mine, one in pairs])
    if not by_scene or not pairs:
        return gaps
    scenes = np.array([one.job.scene for _, one in pairs])
    return np.array([gaps[scenes == scene].mean(0) for scene in np.unique(scenes)])


def _of(results: Sequence[JobResult], entry: str) -> list[JobResult]:
    return [one for one in results if one.job.entry == entry]


def _run(one: JobResult) -> tuple[str, int]:
    return one.job.scene, one.job.seed


def _describe(runs: frozenset[tuple[str, int]]) -> str:
    """The scenes and seeds of a mean."""
    seeds: dict[tuple[int, ...], list[str]] = {}
    for scene in sorted({scene for scene, _ in runs}):
        seeds.setdefault(tuple(sorted(seed for one, seed in runs if one == scene)), []).append(scene)
    return "; ".join(
        f"{', '.join(scenes)}: seed{'s' if len(own) > 1 else ''} {', '.join(map(str, own))}"
        for own, scenes in seeds.items()
    )


def _difference(gaps: np.ndarray) -> str:
    if np.isnan(gaps).any():
        return "-"
    if len(gaps) < 2:
        return f"{gaps.mean():+.3f}"
    low, high = confidence_interval(gaps)
    return f"{gaps.mean():+.3f} [{low:+.3f}, {high:+.3f}]"


def confidence_interval(gaps: np.ndarray, level: float = 0.95) -> tuple[float, float]:
    """Return the interval of the mean of paired differences (N,) by Student's t; unbounded for one pair."""
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
