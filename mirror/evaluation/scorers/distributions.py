"""Scores the set of renders against the set of recorded images: FID, KID, FVD.

Features are cached by the pixels that they were computed from.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from mirror.arrays import AnyArray, Float32, Int64, UInt8
from mirror.errors import DatasetError
from mirror.evaluation.figures import MIN_BLOCKS, TOO_FEW_BLOCKS, assign_blocks
from mirror.evaluation.result import GroupFigure, finite_or_none
from mirror.evaluation.scorers.edit_fidelity import (
    fidelity_figures,
    fidelity_metrics,
    has_fidelity,
    score_fidelity,
)
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.scorers.scorer import HiddenUse, Job, ScoredJob, Values
from mirror.evaluation.submission.manifest import SubmissionManifest
from mirror.metrics.catalogue import MEASURES
from mirror.metrics.features.cache import FeatureCache, feature_key
from mirror.metrics.features.frechet import frechet_distance
from mirror.metrics.features.kid import kid
from mirror.protocols.document import Protocol
from mirror.protocols.metrics import FidMetric, FvdMetric, KidMetric, Metric, metric_name
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView

if TYPE_CHECKING:
    from mirror.metrics.features.extractor import Extractor

Side = Literal["render", "truth"]

_TRUTH: Final = "truth:"
_CLIP: Final = "clip:"
_MIN_KID_SAMPLES: Final = 4


class DistributionScorer:
    """The scorer of the tasks ``vehicle-translation`` and ``generation``."""

    version = 2

    def hidden_use(self, plan: Plan) -> HiddenUse:
        """Return ``optional`` if edits are also scored against their exact truth; the distributions do not need it."""
        return "optional" if fidelity_metrics(plan.protocol) else "unused"

    def needs(self, plan: Plan) -> Mapping[str, tuple[str, ...]]:
        """Return the weights of the networks."""
        return {
            metric_name(metric): MEASURES[metric_name(metric)].needs
            for metric in plan.protocol.metrics
            if isinstance(metric, FidMetric | KidMetric | FvdMetric)
        }

    def unavailable(self, plan: Plan, manifest: SubmissionManifest) -> Mapping[str, str]:
        """Return FVD if no camera has enough consecutive frames for a clip."""
        unavailable = {}
        for metric in plan.protocol.metrics:
            if isinstance(metric, FvdMetric) and not any(split_into_clips(plan.views, metric.frames)):
                unavailable[metric_name(metric)] = (
                    f"no camera has {metric.frames} consecutive frames in split {plan.split}: record longer, or denser"
                )
        return unavailable

    def jobs(self, plan: Plan, inputs: ScoringInputs) -> Sequence[Job]:
        """Return one job for each render, each recorded image (shared by all groups), and each clip of either kind.

        The job of a render also scores its edits, where their exact truth is given.
        """
        jobs: list[Job] = []
        truth_names: set[str] = set()
        needs_images = any(
            isinstance(metric, FidMetric | KidMetric) and metric_name(metric) not in inputs.unavailable
            for metric in plan.protocol.metrics
        )
        for view in plan.views:
            if needs_images or has_fidelity(view, inputs):
                jobs.append(Job(view.path, (view,), (view.path,), truth=has_fidelity(view, inputs)))
            if needs_images and truth_job_name(view) not in truth_names:
                truth_names.add(truth_job_name(view))
                jobs.append(Job(truth_job_name(view), (view,), (), recorded=True, in_table=False))
        for metric in plan.protocol.metrics:
            if isinstance(metric, FvdMetric) and metric_name(metric) not in inputs.unavailable:
                for clip in split_into_clips(plan.views, metric.frames):
                    jobs.append(_make_clip_job(clip, "render"))
                    truth_job = _make_clip_job(clip, "truth")
                    if truth_job.name not in truth_names:
                        truth_names.add(truth_job.name)
                        jobs.append(truth_job)
        return jobs

    def score(self, job: Job, inputs: ScoringInputs) -> Values:
        """Return the cache keys of the job's features, which are computed if needed, and the fidelity of its edits."""
        is_clip = job.name.startswith(_CLIP)
        images = [inputs.render(view) if job.reads else inputs.recorded.image(view) for view in job.views]
        pixels = np.stack(images) if is_clip else images[0]
        values: dict[str, float | int | str | None] = {}
        for kind, network in load_networks(inputs, clips=is_clip).items():
            values[f"feature.{kind}"] = _cache_feature(pixels, network, inputs)
        if job.reads and job.truth:
            values.update(score_fidelity(job.views[0], images[0], inputs))
        return values

    def figures(self, plan: Plan, scored: Sequence[ScoredJob], inputs: ScoringInputs) -> Sequence[GroupFigure]:
        """Return one distance for each group, against the recorded images of the same views."""
        by_name = {scored_job.job.name: scored_job for scored_job in scored}
        figures = fidelity_figures(plan.protocol, [one for one in scored if one.job.in_table], inputs)
        for group in plan.protocol.groups:
            views = [view for view in plan.views if view.group == group.name]
            for metric in plan.protocol.metrics:
                if (
                    isinstance(metric, FidMetric | KidMetric | FvdMetric)
                    and metric_name(metric) not in inputs.unavailable
                    and views
                ):
                    figures.append(_compute_figure(plan.protocol, metric, group.name, views, by_name, inputs))
        return figures


def split_into_clips(views: Iterable[RenderView], frames: int) -> list[tuple[RenderView, ...]]:
    """Cut the views of each camera into clips of `frames` consecutive frames that do not overlap.

    A shorter remainder is left out.
    """
    runs: dict[tuple[str, str, str], list[RenderView]] = {}
    for view in views:
        runs.setdefault((view.group, view.traversal_id, view.camera), []).append(view)
    clips = []
    for run in runs.values():
        run.sort(key=lambda view: view.frame_index)
        start = 0
        for place in range(1, len(run) + 1):
            if place == len(run) or run[place].frame_index != run[place - 1].frame_index + 1:
                start = place
            elif place - start + 1 == frames:
                clips.append(tuple(run[start : place + 1]))
                start = place + 1
    return clips


def truth_job_name(view: RenderView) -> str:
    """Return the name of the job for a view's recorded image, which is the same for all groups."""
    return f"{_TRUTH}{view.traversal_id}/{view.camera}/{view.timestamp_ns}"


def load_networks(inputs: ScoringInputs, *, clips: bool) -> Mapping[str, Extractor]:
    """Return the networks of the available metrics by the kind of their features; each process loads them once."""
    networks: dict[str, Extractor] = {}
    for metric in inputs.protocol.metrics:
        if not isinstance(metric, FidMetric | KidMetric | FvdMetric) or metric_name(metric) in inputs.unavailable:
            continue
        if isinstance(metric, FvdMetric) != clips:
            continue
        kind = _feature_kind(metric)
        if kind not in inputs.made:
            inputs.made[kind] = load_network(metric, inputs)
        networks[kind] = inputs.made[kind]  # type: ignore[assignment]
    return networks


def _feature_kind(metric: Metric) -> str:
    if isinstance(metric, FidMetric | KidMetric):
        return f"inception-{metric.mode}"
    if isinstance(metric, FvdMetric):
        return f"i3d-{metric.crop}"
    raise TypeError(f"{metric.metric} is not a metric of sets")


def load_network(metric: Metric, inputs: ScoringInputs) -> Extractor:
    """Load the network of a metric."""
    if isinstance(metric, FidMetric | KidMetric):
        from mirror.metrics.features.fid import load_inception

        return load_inception(metric.mode, inputs.resolver, inputs.device)
    if isinstance(metric, FvdMetric):
        from mirror.metrics.features.fvd import load_i3d

        return load_i3d(
            "direct224" if metric.crop == "squeeze" else "centre-crop", inputs.resolver, device=inputs.device
        )
    raise TypeError(f"{metric.metric} is not a metric of sets")


def _cache_feature(pixels: UInt8, network: Extractor, inputs: ScoringInputs) -> str:
    from mirror.metrics.features.extractor import extract

    extract(network, [pixels], _cache(inputs))
    return feature_key(pixels, network.identity)


def _cache(inputs: ScoringInputs) -> FeatureCache:
    if "cache" not in inputs.made:
        inputs.made["cache"] = FeatureCache(inputs.features)
    cache: FeatureCache = inputs.made["cache"]  # type: ignore[assignment]
    return cache


def _make_clip_job(clip: tuple[RenderView, ...], side: Side) -> Job:
    first, reads = clip[0], tuple(view.path for view in clip) if side == "render" else ()
    name = first.path if side == "render" else truth_job_name(first)
    return Job(f"{_CLIP}{name}", clip, reads, truth=side == "truth", recorded=side == "truth", in_table=False)


def _compute_figure(
    protocol: Protocol,
    metric: Metric,
    group: str,
    views: Sequence[RenderView],
    scored: Mapping[str, ScoredJob],
    inputs: ScoringInputs,
) -> GroupFigure:
    clips = split_into_clips(views, metric.frames) if isinstance(metric, FvdMetric) else [(view,) for view in views]
    jobs = [_job_names(clip, isinstance(metric, FvdMetric)) for clip in clips]
    column = f"feature.{_feature_kind(metric)}"
    sides = [
        np.stack([_read_feature(scored[names[side]], column, inputs) for names in jobs]) if jobs else np.empty((0, 0))
        for side in (0, 1)
    ]
    distance, min_samples = _select_distance(metric, protocol.intervals.seed)
    name = metric_name(metric)
    unit, better = MEASURES[name].unit, MEASURES[name].better
    if len(jobs) < min_samples:
        reason = f"{len(jobs)} samples; at least {min_samples} are needed"
        return GroupFigure(metric=name, group=group, value=None, reason=reason, unit=unit, better=better, n=len(jobs))
    blocks = assign_blocks(protocol, [clip[0] for clip in clips])
    low, high, interval_reason = _compute_interval(distance, sides[0], sides[1], blocks, protocol, min_samples)
    return GroupFigure(
        metric=name,
        group=group,
        value=finite_or_none(distance(*sides)),
        unit=unit,
        better=better,
        n=len(jobs),
        low=low,
        high=high,
        interval_reason=interval_reason,
        note=_warn_of_few_images(metric, len(jobs)),
    )


def _job_names(clip: tuple[RenderView, ...], is_clip: bool) -> tuple[str, str]:
    if is_clip:
        return _make_clip_job(clip, "render").name, _make_clip_job(clip, "truth").name
    return clip[0].path, truth_job_name(clip[0])


def _read_feature(scored_job: ScoredJob, column: str, inputs: ScoringInputs) -> Float32:
    feature = _cache(inputs).get(str(scored_job.values[column]))
    if feature is None:
        raise DatasetError(
            "a cached feature is missing or damaged",
            file=inputs.features,
            place=scored_job.job.name,
            remedy="delete the folder `work` of the results and run the same command again",
        )
    return feature


def _select_distance(metric: Metric, seed: int) -> tuple[Callable[[AnyArray, AnyArray], float], int]:
    """Return the distance between two sets of features, and the number of samples that it needs in each."""
    if isinstance(metric, KidMetric):
        return lambda render, truth: kid(render, truth, seed=seed).value, _MIN_KID_SAMPLES
    ddof = metric.ddof if isinstance(metric, FvdMetric) else 1
    return lambda render, truth: frechet_distance(render, truth, ddof=ddof).value, 2


def _compute_interval(
    distance: Callable[[AnyArray, AnyArray], float],
    render: AnyArray,
    truth: AnyArray,
    blocks: Int64,
    protocol: Protocol,
    min_samples: int,
) -> tuple[float | None, float | None, str | None]:
    """Compute the percentile interval of a distance by resampling blocks of frames, the same blocks in both sets.

    Resampled sets repeat samples, which increases a distance between sets. Therefore the interval is shifted: its
    median becomes the figure.
    """
    members = [np.flatnonzero(blocks == block) for block in np.unique(blocks)]
    if len(members) < MIN_BLOCKS:
        return None, None, TOO_FEW_BLOCKS
    rng = np.random.default_rng(protocol.intervals.seed)
    figures = []
    for _ in range(protocol.intervals.set_resamples):
        rows = np.concatenate([members[block] for block in rng.integers(len(members), size=len(members))])
        if len(rows) >= min_samples:
            figures.append(distance(render[rows], truth[rows]))
    tail = 0.5 * (1.0 - protocol.intervals.level)
    low, median, high = np.quantile(figures, [tail, 0.5, 1.0 - tail])
    value = distance(render, truth)
    return finite_or_none(value + low - median), finite_or_none(value + high - median), None


def _warn_of_few_images(metric: Metric, count: int) -> str | None:
    if isinstance(metric, FidMetric) and count < metric.warn_below:
        return (
            f"{count} images are fewer than {metric.warn_below}: the distance is biased upwards; compare it only with "
            "figures of the same images"
        )
    return None


SCORER: Final = DistributionScorer()
