"""Scores renders against the recorded images of the same views: PSNR, PSNR*, SSIM and LPIPS."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

from mirror.arrays import Bool, UInt8
from mirror.evaluation.figures import compute_figures, compute_overall_figure
from mirror.evaluation.result import GroupFigure, finite_or_none
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.scorers.scorer import STAND_IN_PREFIX, HiddenUse, Job, ScoredJob, Values
from mirror.evaluation.submission.manifest import SubmissionManifest
from mirror.metrics.catalogue import MEASURES
from mirror.metrics.score import EMPTY_MASK, Score
from mirror.protocols.metrics import ImageMetric, LpipsMetric, Metric, PsnrCcMetric, SsimMetric, metric_name
from mirror.protocols.views.plan import Plan

if TYPE_CHECKING:
    from mirror.metrics.features.perceptual import PerceptualDistance


class ReconstructionScorer:
    """The scorer of the tasks ``reconstruction`` and ``lane-shift``."""

    version = 1

    def hidden_use(self, plan: Plan) -> HiddenUse:
        """Return ``required`` if any group has moved cameras, whose images nobody recorded."""
        return "required" if any(group.ego_shift_m for group in plan.protocol.groups) else "unused"

    def needs(self, plan: Plan) -> Mapping[str, tuple[str, ...]]:
        """Return the weights of LPIPS (trunk and heads) and of ST-LPIPS (one file)."""
        weights: dict[str, tuple[str, ...]] = {}
        for metric in plan.protocol.metrics:
            if isinstance(metric, LpipsMetric):
                names = (metric_name(metric), _stand_in(metric))
                weights |= {name: MEASURES[name].needs for name in names if name in MEASURES}
        return weights

    def unavailable(self, plan: Plan, manifest: SubmissionManifest) -> Mapping[str, str]:
        """Return no metrics: only weights can be missing."""
        return {}

    def jobs(self, plan: Plan, inputs: ScoringInputs) -> Sequence[Job]:
        """Return one job for each view."""
        return [Job(view.path, (view,), (view.path,)) for view in plan.views]

    def score(self, job: Job, inputs: ScoringInputs) -> Values:
        """Compute all metrics of one view."""
        view = job.views[0]
        render, truth, scored = inputs.render(view), inputs.truth.image(view), inputs.scored_mask(view)
        values: dict[str, float | int | str | None] = {
            "scored_px": int(scored.sum()),
            "pixels": scored.size,
        }
        for metric in inputs.protocol.metrics:
            name = computed_metric_name(metric, inputs)
            if name is None:
                continue
            score, more = score_pixels(metric, render, truth, scored, inputs)
            values[name] = float(score)
            if score.reason is not None:
                values[f"{name}.reason"] = score.reason
            values.update(more)
        return values

    def figures(self, plan: Plan, scored: Sequence[ScoredJob], inputs: ScoringInputs) -> Sequence[GroupFigure]:
        """Return the means of each group in the protocol's order, and the PSNR over all pixels of a group.

        Where several groups rank, the means over these groups follow.
        """
        figures: list[GroupFigure] = []
        for group in plan.protocol.groups:
            members = [scored_job for scored_job in scored if scored_job.job.views[0].group == group.name]
            views = [scored_job.job.views[0] for scored_job in members]
            for metric in plan.protocol.metrics:
                name = computed_metric_name(metric, inputs)
                if name is None:
                    continue
                scores = [find_score(scored_job.values, name) for scored_job in members]
                for figure in compute_figures(plan.protocol, MEASURES[name], group.name, views, scores):
                    figures.append(_add_rank_note(figure, name, members) if figure.level == "group" else figure)
                if name == "psnr" and members:
                    figures.append(_compute_pooled_psnr(group.name, members))
        views = [scored_job.job.views[0] for scored_job in scored]
        for metric in plan.protocol.metrics:
            name = computed_metric_name(metric, inputs)
            if name is not None:
                scores = [find_score(scored_job.values, name) for scored_job in scored]
                figures += compute_overall_figure(plan.protocol, MEASURES[name], views, scores)
        return figures


def computed_metric_name(metric: Metric, inputs: ScoringInputs) -> str | None:
    """Return the name of the computed metric; None if it is unavailable.

    ST-LPIPS stands in for an unavailable LPIPS, under its own name.
    """
    name = metric_name(metric)
    if name not in inputs.unavailable:
        return name
    return _stand_in(metric) if isinstance(metric, LpipsMetric) and _stand_in(metric) in inputs.stand_ins else None


def _stand_in(metric: LpipsMetric) -> str:
    return f"{STAND_IN_PREFIX}{metric_name(metric)}"


def find_score(values: Values, name: str) -> Score:
    """Return a job's value of one metric; NaN without a value."""
    value, reason = values.get(name), values.get(f"{name}.reason")
    return Score(math.nan if value is None else float(value), None if reason is None else str(reason))


def score_pixels(
    metric: Metric, render: UInt8, truth: UInt8, scored: Bool, inputs: ScoringInputs
) -> tuple[Score, dict[str, float | int | str | None]]:
    """Compute one metric of the scored pixels of an image, and the values that come with it.

    Args:
        metric: a metric of single images.
        render: (H, W, 3).
        truth: (H, W, 3).
        scored: (H, W) mask of the pixels that are compared; others may affect the windows of structural similarity.
        inputs: weights and networks.
    """
    # Imported late: a run that finds every image scored needs no compiled kernel.
    from mirror.metrics.images.colour_correction import psnr_cc
    from mirror.metrics.images.ssim import ssim

    if not scored.any():
        return EMPTY_MASK, {}
    # Metrics without a mask are faster.
    mask = None if scored.all() else scored
    if isinstance(metric, ImageMetric):
        return MEASURES[metric.metric].load()(render, truth, mask=mask), {}
    if isinstance(metric, PsnrCcMetric):
        corrected = psnr_cc(render, truth, mask=mask, iterations=metric.iterations)
        return corrected.db, {} if corrected.full_rank else {"psnr_cc.rank": corrected.rank}
    if isinstance(metric, SsimMetric):
        return ssim(render, truth, mask=mask, preset=metric.preset, mask_mode=metric.mask), {}
    if isinstance(metric, LpipsMetric):
        return _load_network(metric, inputs)([render], truth, mask, metric.mask)[0], {}
    raise TypeError(f"{metric.metric} is not a metric of single images")


def _load_network(metric: LpipsMetric, inputs: ScoringInputs) -> PerceptualDistance:
    from mirror.metrics.features.lpips import load_lpips
    from mirror.metrics.features.st_lpips import load_st_lpips

    name = computed_metric_name(metric, inputs)
    if name is None:
        raise TypeError(f"{metric_name(metric)} is unavailable")
    if name not in inputs.made:
        if name == metric_name(metric) or metric.net == "squeeze":
            inputs.made[name] = load_lpips(metric.net, inputs.resolver, inputs.device)
        else:
            inputs.made[name] = load_st_lpips(metric.net, inputs.resolver, inputs.device)
    network: PerceptualDistance = inputs.made[name]  # type: ignore[assignment]
    return network


def _add_rank_note(figure: GroupFigure, name: str, scored: Sequence[ScoredJob]) -> GroupFigure:
    deficient = sum(f"{name}.rank" in scored_job.values for scored_job in scored)
    if not deficient:
        return figure
    note = f"the colours of {deficient} images do not determine the warp: the fit of least norm was used"
    return figure.model_copy(update={"note": note})


def _compute_pooled_psnr(group: str, scored: Sequence[ScoredJob]) -> GroupFigure:
    """Compute the PSNR of the mean squared error over all scored pixels of all images, as torchmetrics does."""
    jobs_values = [scored_job.values for scored_job in scored]
    pairs = [(int(values["scored_px"] or 0), find_score(values, "psnr")) for values in jobs_values]
    known = [(pixels, score) for pixels, score in pairs if not math.isnan(score)]
    total = sum(pixels for pixels, _ in known)
    squares = math.fsum(pixels * 10.0 ** (-score / 10.0) for pixels, score in known)
    value = -10.0 * math.log10(squares / total) if squares > 0.0 else None
    reason = None if value is not None else "all images are equal to the truth" if total else "no pixel is scored"
    return GroupFigure(
        metric="psnr_pooled",
        group=group,
        value=None if value is None else finite_or_none(value),
        reason=reason,
        unit=MEASURES["psnr_pooled"].unit,
        better=MEASURES["psnr_pooled"].better,
        n=len(scored),
        n_missing=len(scored) - len(known),
        interval_reason="not resampled",
    )


SCORER: Final = ReconstructionScorer()
