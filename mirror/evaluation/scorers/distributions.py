"""Renders as a set against recorded pictures as a set: FID, KID, FVD. Features are computed once for equal pixels."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from mirror.arrays import AnyArray, Float32, Int64, UInt8
from mirror.errors import DatasetError
from mirror.evaluation.figures import MIN_BLOCKS, TOO_FEW_BLOCKS, assign_blocks
from mirror.evaluation.result import Figure, finite_or_none
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.scorers.scorer import Job, ScoredJob, Values
from mirror.evaluation.submission.manifest import SubmissionManifest
from mirror.metrics.features.cache import FeatureCache, feature_key
from mirror.metrics.features.frechet import frechet_distance
from mirror.metrics.features.kid import kid
from mirror.protocols.document import Fid, Fvd, Kid, Metric, Protocol, metric_name
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView

if TYPE_CHECKING:
    from mirror.metrics.features.extractor import Extractor

Side = Literal["render", "truth"]

_TRUTH: Final = "truth:"
_CLIP: Final = "clip:"
_LEAST_FOR_KID: Final = 4


class Distributions:
    """See the module."""

    version = 1

    def needs_hidden(self, plan: Plan) -> bool:
        """Not here."""
        return False

    def needs(self, plan: Plan) -> Mapping[str, tuple[str, ...]]:
        """The networks' weights."""
        return {
            metric_name(metric): ("i3d-torchscript" if isinstance(metric, Fvd) else "inception-fid",)
            for metric in plan.protocol.metrics
        }

    def unavailable(self, plan: Plan, manifest: SubmissionManifest) -> Mapping[str, str]:
        """Clips that are too short for the protocol."""
        found = {}
        for metric in plan.protocol.metrics:
            if isinstance(metric, Fvd) and not any(split_into_clips(plan.views, metric.frames)):
                found[metric_name(metric)] = (
                    f"no camera has {metric.frames} consecutive frames in split {plan.split}: record longer, or denser"
                )
        return found

    def jobs(self, plan: Plan, inputs: ScoringInputs) -> Sequence[Job]:
        """One a render, one a recorded picture whatever the groups that share it, and one a clip of either."""
        found: list[Job] = []
        seen: set[str] = set()
        pictures = any(
            isinstance(metric, Fid | Kid) and metric_name(metric) not in inputs.unavailable
            for metric in plan.protocol.metrics
        )
        for view in plan.views if pictures else ():
            found.append(Job(view.path, (view,), (view.path,), truth=False))
            if truth_job_name(view) not in seen:
                seen.add(truth_job_name(view))
                found.append(Job(truth_job_name(view), (view,), (), in_table=False))
        for metric in plan.protocol.metrics:
            if isinstance(metric, Fvd) and metric_name(metric) not in inputs.unavailable:
                for clip in split_into_clips(plan.views, metric.frames):
                    found.append(_clip_job(clip, "render"))
                    if _clip_job(clip, "truth").name not in seen:
                        found.append(_clip_job(clip, "truth"))
                        seen.add(found[-1].name)
        return found

    def score(self, job: Job, inputs: ScoringInputs) -> Values:
        """The keys under which features are cached; they are computed if they are not there."""
        clip = job.name.startswith(_CLIP)
        pictures = [inputs.render(view) if job.reads else inputs.truth.image(view) for view in job.views]
        pixels = np.stack(pictures) if clip else pictures[0]
        values: dict[str, float | int | str | None] = {}
        for kind, network in networks(inputs, clips=clip).items():
            values[f"feature.{kind}"] = _known_feature(pixels, network, inputs)
        return values

    def figures(self, plan: Plan, scored: Sequence[ScoredJob], inputs: ScoringInputs) -> Sequence[Figure]:
        """One distance a group, each against the recorded pictures of its own views."""
        by_name = {one.job.name: one for one in scored}
        found = []
        for group in plan.protocol.groups:
            views = [view for view in plan.views if view.group == group.name]
            for metric in plan.protocol.metrics:
                if metric_name(metric) not in inputs.unavailable and views:
                    found.append(_figure(plan.protocol, metric, group.name, views, by_name, inputs))
        return found


def split_into_clips(views: Iterable[RenderView], frames: int) -> list[tuple[RenderView, ...]]:
    """Clips of so many consecutive frames of one camera, side by side; a rest that is shorter is left out."""
    runs: dict[tuple[str, str, str], list[RenderView]] = {}
    for view in views:
        runs.setdefault((view.group, view.traversal_id, view.camera), []).append(view)
    found = []
    for run in runs.values():
        run.sort(key=lambda view: view.frame_index)
        start = 0
        for place in range(1, len(run) + 1):
            if place == len(run) or run[place].frame_index != run[place - 1].frame_index + 1:
                start = place
            elif place - start + 1 == frames:
                found.append(tuple(run[start : place + 1]))
                start = place + 1
    return found


def truth_job_name(view: RenderView) -> str:
    """Name of the job on a view's recorded picture, the same for all groups."""
    return f"{_TRUTH}{view.traversal_id}/{view.camera}/{view.timestamp_ns}"


def networks(inputs: ScoringInputs, *, clips: bool) -> Mapping[str, Extractor]:
    """The networks of the metrics that can be had, by what their features are called, loaded once a process."""
    found: dict[str, Extractor] = {}
    for metric in inputs.protocol.metrics:
        if metric_name(metric) in inputs.unavailable or isinstance(metric, Fvd) != clips:
            continue
        kind = _kind(metric)
        if kind not in inputs.made:
            inputs.made[kind] = load_network(metric, inputs)
        found[kind] = inputs.made[kind]  # type: ignore[assignment]
    return found


def _kind(metric: Metric) -> str:
    if isinstance(metric, Fid | Kid):
        return f"inception-{metric.mode}"
    if isinstance(metric, Fvd):
        return f"i3d-{metric.crop}"
    raise TypeError(f"{metric.metric} is no metric of sets")


def load_network(metric: Metric, inputs: ScoringInputs) -> Extractor:
    """Load the network whose features a metric compares."""
    if isinstance(metric, Fid | Kid):
        from mirror.metrics.features.fid import load_inception

        return load_inception(metric.mode, inputs.resolver)
    if isinstance(metric, Fvd):
        from mirror.metrics.features.fvd import load_i3d

        return load_i3d("direct224" if metric.crop == "squeeze" else "centre-crop", inputs.resolver)
    raise TypeError(f"{metric.metric} is no metric of sets")


def _known_feature(pixels: UInt8, network: Extractor, inputs: ScoringInputs) -> str:
    from mirror.metrics.features.extractor import extract

    extract(network, [pixels], _cache(inputs))
    return feature_key(pixels, network.identity)


def _cache(inputs: ScoringInputs) -> FeatureCache:
    if "cache" not in inputs.made:
        inputs.made["cache"] = FeatureCache(inputs.features)
    found: FeatureCache = inputs.made["cache"]  # type: ignore[assignment]
    return found


def _clip_job(clip: tuple[RenderView, ...], side: Side) -> Job:
    first, reads = clip[0], tuple(view.path for view in clip) if side == "render" else ()
    of = first.path if side == "render" else truth_job_name(first)
    return Job(f"{_CLIP}{of}", clip, reads, truth=side == "truth", in_table=False)


def _figure(
    protocol: Protocol,
    metric: Metric,
    group: str,
    views: Sequence[RenderView],
    scored: Mapping[str, ScoredJob],
    inputs: ScoringInputs,
) -> Figure:
    clips = split_into_clips(views, metric.frames) if isinstance(metric, Fvd) else [(view,) for view in views]
    jobs = [_names(clip, isinstance(metric, Fvd)) for clip in clips]
    column = f"feature.{_kind(metric)}"
    sides = [
        np.stack([_feature(scored[names[place]], column, inputs) for names in jobs]) if jobs else np.empty((0, 0))
        for place in (0, 1)
    ]
    distance, least = _distance(metric, protocol.intervals.seed)
    name = metric_name(metric)
    if len(jobs) < least:
        reason = f"{len(jobs)} samples; at least {least} are needed"
        return Figure(metric=name, group=group, value=None, reason=reason, better="lower", n=len(jobs))
    blocks = assign_blocks(protocol, [clip[0] for clip in clips])
    low, high, why = _interval(distance, sides[0], sides[1], blocks, protocol, least)
    return Figure(
        metric=name,
        group=group,
        value=finite_or_none(distance(*sides)),
        better="lower",
        n=len(jobs),
        low=low,
        high=high,
        interval_reason=why,
        note=_warning(metric, len(jobs)),
    )


def _names(clip: tuple[RenderView, ...], is_clip: bool) -> tuple[str, str]:
    if is_clip:
        return _clip_job(clip, "render").name, _clip_job(clip, "truth").name
    return clip[0].path, truth_job_name(clip[0])


def _feature(one: ScoredJob, column: str, inputs: ScoringInputs) -> Float32:
    found = _cache(inputs).get(str(one.values[column]))
    if found is None:
        raise DatasetError(
            "a cached feature is gone or damaged",
            file=inputs.features,
            place=one.job.name,
            remedy="delete the folder `work` of the results and run the same command again",
        )
    return found


def _distance(metric: Metric, seed: int) -> tuple[Callable[[AnyArray, AnyArray], float], int]:
    """The distance of two sets of features, and how many of either it needs."""
    if isinstance(metric, Kid):
        return lambda render, truth: kid(render, truth, seed=seed).value, _LEAST_FOR_KID
    ddof = metric.ddof if isinstance(metric, Fvd) else 1
    return lambda render, truth: frechet_distance(render, truth, ddof=ddof).value, 2


def _interval(
    distance: Callable[[AnyArray, AnyArray], float],
    render: AnyArray,
    truth: AnyArray,
    blocks: Int64,
    protocol: Protocol,
    least: int,
) -> tuple[float | None, float | None, str | None]:
    """Percentile interval of a distance under resampling of blocks of frames, the same ones of both sets.

    Resampled sets have doubles, by which a distance between sets grows: the interval is of spread, and is placed about
    the figure by subtracting the median.
    """
    members = [np.flatnonzero(blocks == block) for block in np.unique(blocks)]
    if len(members) < MIN_BLOCKS:
        return None, None, TOO_FEW_BLOCKS
    rng = np.random.default_rng(protocol.intervals.seed)
    figures = []
    for _ in range(protocol.intervals.set_resamples):
        rows = np.concatenate([members[place] for place in rng.integers(len(members), size=len(members))])
        if len(rows) >= least:
            figures.append(distance(render[rows], truth[rows]))
    tail = 0.5 * (1.0 - protocol.intervals.level)
    low, middle, high = np.quantile(figures, [tail, 0.5, 1.0 - tail])
    value = distance(render, truth)
    return finite_or_none(value + low - middle), finite_or_none(value + high - middle), None


def _warning(metric: Metric, count: int) -> str | None:
    if isinstance(metric, Fid) and count < metric.warn_below:
        return (
            f"{count} pictures are fewer than {metric.warn_below}: the distance is too large by its bias; compare it "
            "only with figures of the same pictures"
        )
    return None


SCORER: Final = Distributions()
