"""Time and memory of a method: as its submission reports them, and its speed measured here if it is installed."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from mirror.evaluation.result import GroupFigure
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.scorers.scorer import HiddenUse, Job, ScoredJob, Values
from mirror.evaluation.scorers.speed import frames_per_second
from mirror.evaluation.submission.manifest import Runtime, SubmissionManifest
from mirror.methods.appearance import AppearancePolicy
from mirror.methods.registry import load_method
from mirror.metrics.catalogue import MEASURES
from mirror.protocols.metrics import metric_name
from mirror.protocols.views.plan import Plan

_REMEDY: Final = "state it in the manifest under runtime"


class RuntimeScorer:
    """The scorer of the task ``runtime``."""

    version = 1

    def hidden_use(self, plan: Plan) -> HiddenUse:
        """Return ``unused``: the task has no truth."""
        return "unused"

    def needs(self, plan: Plan) -> Mapping[str, tuple[str, ...]]:
        """Return no names: no metric has weights."""
        return {}

    def unavailable(self, plan: Plan, manifest: SubmissionManifest) -> Mapping[str, str]:
        """Return the metrics that the manifest does not state."""
        return {name: _REMEDY for name in plan.protocol.metric_names if reported(manifest.runtime, name) is None}

    def jobs(self, plan: Plan, inputs: ScoringInputs) -> Sequence[Job]:
        """Return no jobs: no render is read."""
        return []

    def score(self, job: Job, inputs: ScoringInputs) -> Values:
        """Return no values."""
        return {}

    def figures(self, plan: Plan, scored: Sequence[ScoredJob], inputs: ScoringInputs) -> Sequence[GroupFigure]:
        """Return the figures of the manifest, and the measured speed."""
        runtime = inputs.manifest.runtime
        figures = []
        for metric in plan.protocol.metrics:
            name = metric_name(metric)
            value = reported(runtime, name)
            if value is None or runtime is None:
                continue
            figures.append(
                GroupFigure(
                    metric=name,
                    group="reported",
                    value=value,
                    unit=MEASURES[name].unit,
                    better=MEASURES[name].better,
                    n=1,
                    interval_reason="reported by the submission",
                    note=f"reported, on {runtime.device}",
                )
            )
        if inputs.measured is not None:
            figures.append(_measure_speed(plan, *inputs.measured))
        return figures


def _measure_speed(plan: Plan, name: str, model: Path) -> GroupFigure:
    speed, count = frames_per_second(load_method(name).open(model, AppearancePolicy()), plan.views)
    return GroupFigure(
        metric="frames_per_second",
        group="measured",
        value=speed,
        unit=MEASURES["frames_per_second"].unit,
        better=MEASURES["frames_per_second"].better,
        n=count,
        interval_reason="one run",
        note=f"measured here, on {platform.processor() or platform.machine()}",
    )


def reported(runtime: Runtime | None, name: str) -> float | None:
    """Return one figure of a manifest; None if the manifest does not state it."""
    if runtime is None:
        return None
    if name == "model_bytes_per_100m":
        if runtime.model_bytes is None or runtime.driven_m is None:
            return None
        return 100.0 * runtime.model_bytes / runtime.driven_m
    value: float | None = getattr(runtime, name)
    return value


SCORER: Final = RuntimeScorer()
