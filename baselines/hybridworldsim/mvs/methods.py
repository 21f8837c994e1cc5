"""The estimators of depth by name."""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal

from hybridworldsim.mvs.estimator import DepthEstimator
from hybridworldsim.mvs.plane_sweep import PlaneSweep
from mirror.errors import UsageError

Method = Literal["plane-sweep", "mvsnet", "patchmatchnet", "sparse"]
SPARSE: Final = "sparse"
"""The method that estimates no depth: it matches features and triangulates them."""

MIN_CONFIDENCE: Final = {"plane-sweep": 0.05, "mvsnet": 0.8, "patchmatchnet": 0.8}
"""Confidence below which an estimate is unknown, by method."""


def make_estimator(method: str, weights: Path | None = None) -> DepthEstimator:
    """An estimator; its ``repr`` names all that its results depend on.

    Args:
        method: its name.
        weights: where its weights lie; None: where weights are looked for.

    Raises:
        UsageError: there is no such method, or it takes no weights.
        WeightsUnavailableError: they are not there, or are others.
    """
    if method in ("mvsnet", "patchmatchnet"):
        from mirror.weights.resolve import WeightResolver

        resolver = WeightResolver({} if weights is None else {method: weights})
        if method == "mvsnet":
            from hybridworldsim.mvs.mvsnet.estimator import MVSNetEstimator

            return MVSNetEstimator.load(resolver)
        from hybridworldsim.mvs.patchmatchnet.estimator import PatchmatchNetEstimator

        return PatchmatchNetEstimator.load(resolver)
    if method != "plane-sweep":
        raise UsageError(f"no estimator is called {method!r}", expected="plane-sweep, mvsnet or patchmatchnet")
    if weights is not None:
        raise UsageError("plane-sweep has no weights", remedy="leave --weights out")
    return PlaneSweep()
