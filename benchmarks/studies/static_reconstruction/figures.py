"""Figures of the study: what each method renders of the same views, and quality over the budget."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from benchmarks.studies.static_reconstruction.declaration import NOVEL, TRAINING, load_declaration
from benchmarks.studies.static_reconstruction.jobs import Job
from benchmarks.studies.static_reconstruction.scoring import score_image
from benchmarks.studies.static_reconstruction.tables import JobResult
from benchmarks.studies.static_reconstruction.truth.trained import TrainedModel
from benchmarks.studies.tiles import sheet
from mirror.arrays import UInt8
from mirror.schema.files import write_bytes

_SHOWN: Final = ((NOVEL, "front_wide"), (NOVEL, "front_right"), (TRAINING, "front_wide"), (TRAINING, "rear_left"))
_CURVES: Final = (("train PSNR", "training images, PSNR, dB"), ("novel PSNR*", "held-out traversal, PSNR*, dB"))


def write_sheet(jobs: Sequence[Job], folder: Path, path: Path) -> None:
    """Write the recorded images of a few views of a scene beside the renders of models, as a JPEG sheet.

    Args:
        jobs: finished jobs of one scene.
        folder: working folder of the study.
        path: of the sheet.
    """
    models = [TrainedModel(job, folder, load_declaration()) for job in jobs]
    renderers = [model.open() for model in models]
    rows = []
    for group, camera in _SHOWN:
        own = [view for view in models[0].views(group) if view.camera == camera]
        if not own:
            continue
        view = own[len(own) // 2]
        true, mask = models[0].street.recorded.image(view), models[0].street.recorded.scored_mask(view)
        row = [(f"{group}, {view.light}, {view.weather}", _dimmed(true, mask))]
        for job, render in zip(jobs, renderers):
            rendered = render(view)
            scores = score_image(view, rendered, true, mask)
            row.append((f"{job.entry} {scores.psnr:.1f}, * {scores.psnr_cc:.1f} dB", rendered))
        rows.append(row)
    sheet_bgr = np.ascontiguousarray(sheet(rows)[..., ::-1])
    write_bytes(path, bytes(cv2.imencode(".jpg", sheet_bgr, [cv2.IMWRITE_JPEG_QUALITY, 90])[1]))


def _dimmed(image: UInt8, mask: np.ndarray) -> UInt8:
    """An image whose pixels that are not scored are dark."""
    dark: UInt8 = np.where(mask[..., None], image, image // 4)
    return dark


def write_budgets(results: Sequence[JobResult], entries: Sequence[str], path: Path) -> None:
    """Plot quality over core-minutes, a line for each entry, as PNG; means over scenes and seeds that all entries have.

    Nothing is written if no entry has several budgets.
    """
    budgets = {entry: {one.job.core_minutes for one in results if one.job.entry == entry} for entry in entries}
    plotted = [entry for entry in entries if len(budgets[entry]) > 1]
    if not plotted:
        return
    common = set.intersection(*(_complete(results, entry, budgets[entry]) for entry in plotted))
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, panels = pyplot.subplots(1, len(_CURVES), figsize=(10.0, 4.0), layout="constrained")
    for panel, (name, label) in zip(panels, _CURVES):
        for entry in plotted:
            own = [one for one in results if one.job.entry == entry and (one.job.scene, one.job.seed) in common]
            if own:
                along = sorted(budgets[entry])
                means = [np.mean([one.figures[name] for one in own if one.job.core_minutes == at]) for at in along]
                panel.plot(along, means, marker="o", label=entry)
        panel.set(xscale="log", xlabel="core-minutes of training", ylabel=label)
        every = sorted(set().union(*(budgets[entry] for entry in plotted)))
        panel.set_xticks(every, [f"{minutes:g}" for minutes in every])
        panel.minorticks_off()
        panel.grid(alpha=0.3)
    panels[0].legend(fontsize=8)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def _complete(results: Sequence[JobResult], entry: str, budgets: set[float]) -> set[tuple[str, int]]:
    """Scenes and seeds of which an entry has all its budgets."""
    there: dict[tuple[str, int], set[float]] = {}
    for one in results:
        if one.job.entry == entry:
            there.setdefault((one.job.scene, one.job.seed), set()).add(one.job.core_minutes)
    return {key for key, own in there.items() if own == budgets}
