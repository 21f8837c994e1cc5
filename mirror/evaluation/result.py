"""``result.json``: the figures of a submission, and everything that decides whether two results are comparable."""

from __future__ import annotations

import math
from typing import Final, Literal

from pydantic import Field

from mirror.evaluation.submission.manifest import SubmissionManifest
from mirror.protocols.document import Protocol
from mirror.schema.documents import Document
from mirror.schema.hashing import HashStyle, hash_document

RESULT: Final = "result.json"
IMAGES: Final = "images.parquet"

Level = Literal["group", "scene", "traversal", "camera", "condition"]


class GroupFigure(Document):
    """One figure of a table.

    Attributes:
        metric: name of the metric.
        group: group of the protocol.
        level: the part that the figure describes: the group, or one scene, traversal, camera or condition in it.
        key: name of that scene, traversal, camera or condition; empty for a group.
        value: value of the figure; None: it has none, and ``reason`` explains why.
        reason: why there is no value.
        unit: unit of the value.
        better: which direction is better.
        n: number of images, clips or objects.
        n_inf: number of infinite ones among them, which are left out of the mean.
        n_missing: number without a value among them, which are left out of the mean.
        low: lower end of the confidence interval; None: there is no interval.
        high: upper end of the confidence interval.
        interval_reason: why there is no interval.
        note: remark for readers.
    """

    metric: str
    group: str
    level: Level = "group"
    key: str = ""
    value: float | None = Field(allow_inf_nan=False)
    reason: str | None = None
    unit: str = ""
    better: Literal["higher", "lower", "none"]
    n: int
    n_inf: int = 0
    n_missing: int = 0
    low: float | None = Field(default=None, allow_inf_nan=False)
    high: float | None = Field(default=None, allow_inf_nan=False)
    interval_reason: str | None = None
    note: str | None = None


class ClusterMean(Document):
    """The mean of the ranking figure in one cluster: a scene, or a scenario in a scene.

    Attributes:
        key: the scene, or ``SCENE, SCENARIO``.
        value: mean in the cluster, in the protocol's order.
        weight: share of the cluster in the figure that ranks; all shares have the sum 1.
        n: number of finite scores.
    """

    key: str
    value: float = Field(allow_inf_nan=False)
    weight: float = Field(gt=0, le=1 + 1e-9)
    n: int = Field(ge=1)


class DatasetIdentity(Document):
    """The identity of the truth that a submission was scored against.

    Attributes:
        split: name of the split.
        dataset_hash: hash of the dataset that the split was made from.
        plan_hash: hash of the plan, that is of the requested views.
        hidden_truth: hash of the hidden images, if hidden truth was used.
    """

    split: str
    dataset_hash: str
    plan_hash: str
    hidden_truth: str | None = None


class Result(Document):
    """``result.json``: the figures of one submission.

    Attributes:
        format: always ``mirror-result``.
        version: version of this document's format.
        protocol: the complete protocol.
        protocol_hash: hash of the protocol.
        dataset: identity of the truth.
        submission: manifest of the submission.
        submission_hash: hash of all renders of the submission.
        figures: the figures.
        clusters: means of the figure that ranks in each scene, or scenario of a scene; empty: none ranks, or one of a
            whole set. The hash omits an empty one.
        unavailable: metrics that could not be computed, each with the way to make it available.
        weights: SHA-256 of the network weights that were used, by name.
        versions: versions of the toolkit and of packages that affect the figures.
        options: options that affect the figures, such as the extractor of edited regions.
        warnings: remarks for readers.
    """

    format: Literal["mirror-result"] = "mirror-result"
    version: Literal["1.0"] = "1.0"
    protocol: Protocol
    protocol_hash: str
    dataset: DatasetIdentity
    submission: SubmissionManifest
    submission_hash: str
    figures: tuple[GroupFigure, ...]
    clusters: tuple[ClusterMean, ...] = Field(default=(), exclude_if=lambda clusters: not clusters)
    unavailable: dict[str, str]
    weights: dict[str, str]
    versions: dict[str, str]
    options: dict[str, str] = Field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def _repr_html_(self) -> str:
        """Return the figures of the groups as an HTML table for notebooks."""
        from mirror.metrics.catalogue import find_measure
        from mirror.pages.notebook import show_rows
        from mirror.protocols.ranking import group_title

        rows = []
        for one in self.figures:
            if one.level == "group":
                measure = find_measure(one.metric)
                bounds = () if one.low is None or one.high is None else (one.low, one.high)
                interval = " to ".join(map(measure.format_exactly, bounds))
                value = one.reason or "none"
                if one.value is not None:
                    value = f"{measure.format_exactly(one.value)} {measure.unit}".strip()
                rows.append((group_title(one.group), measure.title, value, interval, one.n))
        title = f"{self.submission.method.name}: {self.protocol.name}"
        return show_rows(title, ("group", "figure", "value", "interval", "n"), rows)

    @property
    def hash(self) -> str:
        """SHA-256 of the canonical content; leaderboard entries refer to it."""
        plain = self.model_dump(mode="json")
        return hash_document(plain, HashStyle.CANONICAL)


def finite_or_none(value: float) -> float | None:
    """Convert a value for JSON: None replaces NaN and infinity."""
    return float(value) if math.isfinite(value) else None
