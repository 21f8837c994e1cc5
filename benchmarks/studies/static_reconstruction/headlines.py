"""The short tables of the report, which put a few figures of several groups side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from benchmarks.studies.static_reconstruction.declaration import NOVEL, TRAINING, Declaration
from benchmarks.studies.static_reconstruction.groups import Group, groups
from benchmarks.studies.static_reconstruction.methods import OURS, STRUCTURE, trial
from benchmarks.studies.static_reconstruction.records import EXACT_STREET_ROWS, Document
from benchmarks.studies.static_reconstruction.tables import JobResult, confidence_interval, paired_differences

_NAMES: Final = ("train PSNR", "novel PSNR*")
_TUNED: Final = "mtgs_style-tuned"
_PAPER_DB: Final = (1.42, 1.66)
"""The paper's margins over MTGS on its own recordings, quoted."""
_COMPARISONS: Final = (
    ("equal time", "comparison", _TUNED),
    ("equal bytes", "bytes", "mtgs_style-bytes"),
    ("thirty minutes, 480 pixels, one street and seed", "long", _TUNED),
)


def summary_table(results: Sequence[JobResult], declaration: Declaration) -> str:
    """Write the leads of both of ours over MTGS-style, in each comparison and in the paper."""
    titles = ["", "training PSNR, dB", "by street", "PSNR\\* of the held-out traversal, dB", "by street"]
    rows = []
    for label, name, baseline in _COMPARISONS:
        group = groups(declaration)[name]  # type: ignore[index]
        own = [one for one in results if group.has(one.job)]
        for entry in (OURS, STRUCTURE):
            by_run, by_street = (paired_differences(own, entry, baseline, _NAMES, by_scene=by) for by in (False, True))
            cells = [cell for column in range(len(_NAMES)) for cell in _margin(by_run[:, column], by_street[:, column])]
            rows.append([f"{label}, `{entry}`", *cells])
    rows.append(["the paper on its own recordings", f"{_PAPER_DB[0]:+.2f}", "", f"{_PAPER_DB[1]:+.2f}", ""])
    return _markdown(titles, rows)


def _margin(by_run: np.ndarray, by_street: np.ndarray) -> tuple[str, str]:
    """A mean with its interval over pairs, and the interval over streets; no interval of one pair."""
    mean = f"{by_run.mean():+.2f}"
    if len(by_run) < 2:
        return mean, ""
    intervals = (confidence_interval(gaps) for gaps in (by_run, by_street))
    over_pairs, over_streets = (f"[{low:.2f}, {high:.2f}]" for low, high in intervals)
    return f"{mean} {over_pairs}", over_streets


def scene_table(results: Sequence[JobResult], exact: Sequence[Document], group: Group) -> str:
    """Format the training PSNR and held-out PSNR* of each scene.

    Of the exact street at recorded poses, and of three methods.
    """
    scenes = sorted(group.scenes)
    streets = {one["scene"]: _exact_figures(one) for one in exact if one["width_px"] == group.width_px}
    rows = [["the exact street", *(f"{streets[scene][0]:.2f} / {streets[scene][1]:.2f}" for scene in scenes)]]
    for entry in (OURS, STRUCTURE, _TUNED):
        own = [one for one in results if group.has(one.job) and one.job.entry == entry]
        cells = [_figures([one for one in own if one.job.scene == scene]) for scene in scenes]
        rows.append([f"`{entry}`, mean of the seeds", *cells])
    return _markdown(["training PSNR / PSNR\\*", *scenes], rows)


def _exact_figures(one: Document) -> tuple[float, float]:
    """PSNR of training images, and PSNR* of held-out images in the declared appearance, from recorded poses."""
    rows = {
        (row["group"], row["light"] == "own"): row for row in one[EXACT_STREET_ROWS] if row["poses"] == "recorded"
    }  # fmt: skip
    return rows[TRAINING, True]["psnr"], rows[NOVEL, False]["psnr_cc"]


def budget_table(results: Sequence[JobResult], group: Group) -> str:
    """Return the training PSNR and held-out PSNR* of each entry after each budget."""
    first, *others = group.minutes
    titles = [f"{first:g} core-minutes", *(f"{minutes:g}" for minutes in others)]
    own = [one for one in results if group.has(one.job)]
    rows = [
        [f"`{entry}`", *(_figures([one for one in own if (one.job.entry, one.job.core_minutes) == (entry, minutes)])
                         for minutes in group.minutes)]
        for entry in group.shown
    ]  # fmt: skip
    return _markdown(["training PSNR / PSNR\\* of the held-out traversal, dB", *titles], rows)


def tuning_cell_table(results: Sequence[JobResult], declaration: Declaration) -> str:
    """Format the results of cells of MTGS-style's grid with the budget of the comparison."""
    group = groups(declaration)["comparison"]
    entries = {
        (1.0, 2.0): _TUNED,
        **{cell: trial("mtgs_style", *cell) for cell in ((1.0, 4.0), (2.0, 2.0), (2.0, 1.0))},
    }
    rows = []
    for (rates, sizes), entry in entries.items():
        (one,) = (
            one for one in results
            if one.job.entry == entry and one.job.scene == group.scenes[0] and one.job.seed == group.seeds[0]
            and (one.job.core_minutes,) == group.minutes and one.job.width_px == group.width_px
        )  # fmt: skip
        figures = one.figures
        rows.append([
            f"({rates:g}, {sizes:g})", f"{figures['train PSNR']:.2f}", f"{figures['novel PSNR*']:.2f}",
            f"{figures['MB']:.1f}",
        ])  # fmt: skip
    return _markdown(["`mtgs_style` after ten core-minutes", "training PSNR", "PSNR\\*", "MB"], rows)


def _figures(results: Sequence[JobResult]) -> str:
    return " / ".join(f"{np.mean([one.figures[name] for one in results]):.2f}" for name in _NAMES)


def _markdown(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [titles, *rows]
    texts = [f"| {' | '.join(line)} |" for line in lines]
    return "\n".join([texts[0], "|---" * len(titles) + "|", *texts[1:]])
