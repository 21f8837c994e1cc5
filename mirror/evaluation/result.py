"""``result.json``: what a submission scored, and everything that decides whether two results can be compared."""

from __future__ import annotations

import hashlib
import json
import math
from typing import Final, Literal

from pydantic import Field

from mirror.evaluation.submission.manifest import SubmissionManifest
from mirror.protocols.document import Protocol
from mirror.schema.documents import Document

RESULT: Final = "result.json"
IMAGES: Final = "images.parquet"

Level = Literal["group", "scene", "traversal", "camera", "condition"]


class Figure(Document):
    """One figure of a table.

    Attributes:
        metric: its name.
        group: the protocol's group.
        level: what it is of: the whole group, or one scene, traversal, camera or condition in it.
        key: which of these; empty for a group.
        value: the figure; None: there is none, and ``reason`` says why.
        reason: why there is none.
        unit: of the figure.
        better: which way is better.
        n: how many pictures, clips or objects it is of.
        n_inf: of those, how many are infinite, and in no mean.
        n_missing: of those, how many have no value, and are in no mean.
        low: lower end of the confidence interval; None: there is none.
        high: upper end.
        interval_reason: why there is no interval.
        note: what a reader must know.
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


class DatasetIdentity(Document):
    """Which truth it was.

    Attributes:
        split: name of the split.
        dataset_hash: of what the split was made of.
        plan_hash: of the views that were asked for.
        hidden_truth: hash of an organiser's pictures, where they were the truth.
    """

    split: str
    dataset_hash: str
    plan_hash: str
    hidden_truth: str | None = None


class Result(Document):
    """``result.json``.

    Attributes:
        format: always ``mirror-result``.
        version: of this document.
        protocol: the whole protocol, as data.
        protocol_hash: of it.
        dataset: the truth.
        submission: the submission's manifest.
        submission_hash: of all its renders.
        figures: what it scored.
        unavailable: metrics that could not be had, and how to get them.
        weights: SHA-256 of the weights that were used, by name.
        versions: of this toolkit and of what the figures depend on.
        options: what else decides the figures, such as the extractor of edited regions.
        warnings: what a reader must know.
    """

    format: Literal["mirror-result"] = "mirror-result"
    version: Literal["1.0"] = "1.0"
    protocol: Protocol
    protocol_hash: str
    dataset: DatasetIdentity
    submission: SubmissionManifest
    submission_hash: str
    figures: tuple[Figure, ...]
    unavailable: dict[str, str]
    weights: dict[str, str]
    versions: dict[str, str]
    options: dict[str, str] = Field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def hash(self) -> str:
        """SHA-256 of the canonical content: what an entry of a board refers to."""
        plain = self.model_dump(mode="json")
        return hashlib.sha256(json.dumps(plain, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def finite_or_none(value: float) -> float | None:
    """A figure as JSON has it: None for NaN and infinity."""
    return float(value) if math.isfinite(value) else None
