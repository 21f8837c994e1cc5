"""The interface of scorers: independent jobs for worker processes, and figures computed from the jobs' values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, Protocol, TypeAlias

from mirror.evaluation.result import GroupFigure
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.submission.manifest import SubmissionManifest
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView

STAND_IN_PREFIX: Final = "st_"

HiddenUse: TypeAlias = Literal["required", "optional", "unused"]
"""A scorer's use of the organiser's hidden truth; without optional one, some metrics are unavailable."""

Values: TypeAlias = Mapping[str, float | int | str | None]
"""Values of a job by name, such as a metric's; the key ``<name>.reason`` states why a value is NaN."""


@dataclass(frozen=True)
class Job:
    """One unit of work of a scorer.

    Attributes:
        name: name of the job, unique within the evaluation.
        views: the views that it scores; the table of images has the keys of the first one.
        reads: files of the submission that it reads.
        truth: whether it reads the truth of its views: hidden truth where that is given, else the recorded images.
        recorded: whether that truth is the recorded images in any case.
        in_table: whether it is a row of the table of images.
        fingerprint: hash of what else its values depend on, such as a mask of an extractor; a change is scored again.
    """

    name: str
    views: tuple[RenderView, ...]
    reads: tuple[str, ...]
    truth: bool = True
    recorded: bool = False
    in_table: bool = True
    fingerprint: str = ""


@dataclass(frozen=True)
class ScoredJob:
    """A job with its values."""

    job: Job
    values: Values


class Scorer(Protocol):
    """A scorer of the submissions of one task."""

    version: int
    """Version of the scorer's values: increased when they change, so that stored values are not reused."""

    def hidden_use(self, plan: Plan) -> HiddenUse:
        """Return whether the views need the organiser's hidden truth, because their images were not recorded."""

    def needs(self, plan: Plan) -> Mapping[str, tuple[str, ...]]:
        """Return the names of the weights that each metric needs; metrics without weights may be left out.

        A key that starts with `STAND_IN_PREFIX` names a stand-in: a metric that is computed if the metric named after
        the prefix has no weights.
        """

    def unavailable(self, plan: Plan, manifest: SubmissionManifest) -> Mapping[str, str]:
        """Return the metrics that are unavailable for other reasons than missing weights, each with its remedy."""

    def jobs(self, plan: Plan, inputs: ScoringInputs) -> Sequence[Job]:
        """Return the jobs, ordered so that neighbours read the same files."""

    def score(self, job: Job, inputs: ScoringInputs) -> Values:
        """Compute the values of one job; called in a worker process."""

    def figures(self, plan: Plan, scored: Sequence[ScoredJob], inputs: ScoringInputs) -> Sequence[GroupFigure]:
        """Compute the figures of the result from the values of all jobs."""
