"""Renders against the pictures that were taken there: PSNR, PSNR*, SSIM, LPIPS of every view."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

from mirror.arrays import Bool, UInt8
from mirror.evaluation.figures import Measure, compute_figures
from mirror.evaluation.result import Figure, finite_or_none
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.scorers.scorer import STAND_IN_PREFIX, Job, ScoredJob, Values
from mirror.evaluation.submission.manifest import SubmissionManifest
from mirror.metrics.features.lpips import TRUNK_WEIGHTS
from mirror.metrics.images.colour_correction import psnr_cc
from mirror.metrics.images.psnr import psnr
from mirror.metrics.images.ssim import ssim
from mirror.metrics.score import EMPTY_MASK, Score
from mirror.protocols.document import Lpips, Metric, Psnr, PsnrCc, Ssim, metric_name
from mirror.protocols.views.plan import Plan

if TYPE_CHECKING:
    from mirror.metrics.features.perceptual import PerceptualDistance

_MEASURES: Final = {
    "psnr": Measure("psnr", "dB", "higher"),
    "psnr_cc": Measure("psnr_cc", "dB", "higher"),
    "ssim": Measure("ssim", "", "higher"),
}


class Reconstruction:
    """See the module."""

    version = 1

    def needs_hidden(self, plan: Plan) -> bool:
        """Pictures of moved cameras were not recorded."""
        return any(group.ego_shift_m for group in plan.protocol.groups)

    def needs(self, plan: Plan) -> Mapping[str, tuple[str, ...]]:
        """LPIPS needs its trunk and heads, ST-LPIPS a file of its own."""
        found: dict[str, tuple[str, ...]] = {}
        for metric in plan.protocol.metrics:
            if isinstance(metric, Lpips):
                found[metric_name(metric)] = (TRUNK_WEIGHTS[metric.net], f"lpips-heads-{metric.net}")
                if metric.net != "squeeze":
                    found[_stand_in(metric)] = (f"st-lpips-{metric.net}",)
        return found

    def unavailable(self, plan: Plan, manifest: SubmissionManifest) -> Mapping[str, str]:
        """Nothing else is needed."""
        return {}

    def jobs(self, plan: Plan, inputs: ScoringInputs) -> Sequence[Job]:
        """One a view."""
        return [Job(view.path, (view,), (view.path,)) for view in plan.views]

    def score(self, job: Job, inputs: ScoringInputs) -> Values:
        """All metrics of one view."""
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
            score, more = _score(metric, render, truth, scored, inputs)
            values[name] = float(score)
            if score.reason is not None:
                values[f"{name}.reason"] = score.reason
            values.update(more)
        return values

    def figures(self, plan: Plan, scored: Sequence[ScoredJob], inputs: ScoringInputs) -> Sequence[Figure]:
        """Means in the protocol's order; PSNR also of all pixels together."""
        found: list[Figure] = []
        for group in plan.protocol.groups:
            own = [one for one in scored if one.job.views[0].group == group.name]
            views = [one.job.views[0] for one in own]
            for metric in plan.protocol.metrics:
                name = computed_metric_name(metric, inputs)
                if name is None:
                    continue
                scores = [find_score(one.values, name) for one in own]
                measure = _MEASURES.get(name, Measure(name, "", "lower"))
                figures = compute_figures(plan.protocol, measure, group.name, views, scores)
                found += [_noted(figure, name, own) if figure.level == "group" else figure for figure in figures]
                if name == "psnr" and own:
                    found.append(_pooled(group.name, own))
        return found


def computed_metric_name(metric: Metric, inputs: ScoringInputs) -> str | None:
    """What a metric's figure is called: where LPIPS cannot be had ST-LPIPS stands in, under its own name; or None."""
    name = metric_name(metric)
    if name not in inputs.unavailable:
        return name
    return _stand_in(metric) if isinstance(metric, Lpips) and _stand_in(metric) in inputs.stand_ins else None


def _stand_in(metric: Lpips) -> str:
    return f"{STAND_IN_PREFIX}{metric_name(metric)}"


def find_score(values: Values, name: str) -> Score:
    """A job's value of one metric."""
    value, reason = values.get(name), values.get(f"{name}.reason")
    return Score(math.nan if value is None else float(value), None if reason is None else str(reason))


def _score(
    metric: Metric, render: UInt8, truth: UInt8, scored: Bool, inputs: ScoringInputs
) -> tuple[Score, dict[str, float | int | str | None]]:
    if not scored.any():
        return EMPTY_MASK, {}
    # Without a mask the faster ways are open.
    mask = None if scored.all() else scored
    if isinstance(metric, Psnr):
        return psnr(render, truth, mask=mask), {}
    if isinstance(metric, PsnrCc):
        corrected = psnr_cc(render, truth, mask=mask, iterations=metric.iterations)
        return corrected.db, {} if corrected.full_rank else {"psnr_cc.rank": corrected.rank}
    if isinstance(metric, Ssim):
        return ssim(render, truth, mask=mask, preset=metric.preset, mask_mode=metric.mask), {}
    if isinstance(metric, Lpips):
        return _network(metric, inputs)([render], truth, mask, metric.mask)[0], {}
    raise TypeError(f"{metric.metric} is no metric of single pictures")


def _network(metric: Lpips, inputs: ScoringInputs) -> PerceptualDistance:
    from mirror.metrics.features.lpips import load_lpips
    from mirror.metrics.features.st_lpips import load_st_lpips

    name = computed_metric_name(metric, inputs)
    if name is None:
        raise TypeError(f"{metric_name(metric)} cannot be had")
    if name not in inputs.made:
        if name == metric_name(metric) or metric.net == "squeeze":
            inputs.made[name] = load_lpips(metric.net, inputs.resolver)
        else:
            inputs.made[name] = load_st_lpips(metric.net, inputs.resolver)
    network: PerceptualDistance = inputs.made[name]  # type: ignore[assignment]
    return network


def _noted(figure: Figure, name: str, scored: Sequence[ScoredJob]) -> Figure:
    deficient = sum(f"{name}.rank" in one.values for one in scored)
    if not deficient:
        return figure
    note = f"of {deficient} pictures the colours do not determine the warp: the fit of least norm was taken"
    return figure.model_copy(update={"note": note})


def _pooled(group: str, scored: Sequence[ScoredJob]) -> Figure:
    """PSNR of the mean square over all scored pixels of all pictures, as torchmetrics accumulates it."""
    pairs = [(int(one.values["scored_px"] or 0), find_score(one.values, "psnr")) for one in scored]
    known = [(pixels, score) for pixels, score in pairs if not math.isnan(score)]
    total = sum(pixels for pixels, _ in known)
    squares = math.fsum(pixels * 10.0 ** (-score / 10.0) for pixels, score in known)
    value = -10.0 * math.log10(squares / total) if squares > 0.0 else None
    reason = None if value is not None else "all pictures are equal to the truth" if total else "no pixel is scored"
    return Figure(
        metric="psnr_pooled",
        group=group,
        value=None if value is None else finite_or_none(value),
        reason=reason,
        unit="dB",
        better="higher",
        n=len(scored),
        n_missing=len(scored) - len(known),
        interval_reason="not resampled",
    )


SCORER: Final = Reconstruction()
