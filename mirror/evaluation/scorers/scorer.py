"""What a scorer is: jobs that workers do one by one, and figures of what they found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol, TypeAlias

from mirror.evaluation.result import Figure
from mirror.evaluation.scorers.inputs import ScoringInputs
from mirror.evaluation.submission.manifest import SubmissionManifest
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView

STAND_IN_PREFIX: Final = "st_"

Values: TypeAlias = Mapping[str, float | int | str | None]
"""What a job found: a metric's name to its value; ``<name>.reason`` says why it is NaN."""


@dataclass(frozen=True)
class Job:
    """One piece of work.

    Attributes:
        name: within the evaluation.
        views: that it is about; the first one's keys stand in the table of images.
        reads: files of the submission that it reads.
        truth: whether it reads the recorded picture of its views.
        tabled: whether it is a row of the table of images.
    """

    name: str
    views: tuple[RenderView, ...]
    reads: tuple[str, ...]
    truth: bool = True
    in_table: bool = True


@dataclass(frozen=True)
class ScoredJob:
    """A job and what it found."""

    job: Job
    values: Values


class Scorer(Protocol):
    """Scores one task."""

    version: int
    """Counted up when values change: what was scored before is scored again."""

    def needs_hidden(self, plan: Plan) -> bool:
        """Whether nobody recorded the truth of the views, so that it is an organiser's."""

    def needs(self, plan: Plan) -> Mapping[str, tuple[str, ...]]:
        """Names of the weights that each metric needs; a metric that needs none may be left out.

        A name that begins with `STAND_IN_PREFIX` names a stand-in: another metric that is computed where the metric
        named after the prefix has no weights.
        """

    def unavailable(self, plan: Plan, manifest: SubmissionManifest) -> Mapping[str, str]:
        """Metrics that cannot be had for another reason than weights, and how to get them."""

    def jobs(self, plan: Plan, inputs: ScoringInputs) -> Sequence[Job]:
        """The work to do, in an order in which neighbours share what they read."""

    def score(self, job: Job, inputs: ScoringInputs) -> Values:
        """Do one job; called in a worker process."""

    def figures(self, plan: Plan, scored: Sequence[ScoredJob], inputs: ScoringInputs) -> Sequence[Figure]:
        """What it comes to."""
