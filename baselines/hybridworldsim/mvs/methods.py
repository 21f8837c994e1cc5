"""Depth estimators by name."""

from __future__ import annotations

from pathlib import Path
from typing import Final, Literal

from hybridworldsim.mvs.estimator import DepthEstimator
from hybridworldsim.mvs.plane_sweep import PlaneSweep
from mirror.devices import CPU
from mirror.errors import UsageError

Method = Literal["plane-sweep", "mvsnet", "patchmatchnet", "sparse"]
LEARNED: Final = ("mvsnet", "patchmatchnet")
"""The methods that are networks."""

SPARSE: Final = "sparse"
"""The method without depth: it matches features and triangulates them, on the CPU."""

MIN_CONFIDENCE: Final = {"plane-sweep": 0.05, "mvsnet": 0.8, "patchmatchnet": 0.8}
"""By method, the confidence below which a depth counts as unknown."""


def make_estimator(method: str, weights: Path | None = None, device: str = CPU) -> DepthEstimator:
    """Make an estimator; its ``repr`` names everything that its results depend on.

    Args:
        method: name of the estimator.
        weights: file with its weights; None: `WeightResolver` finds the file.
        device: where it computes, as torch names it.

    Raises:
        UsageError: no method has this name, or the method takes no weights.
        WeightsUnavailableError: the weights are missing, or have another hash.
    """
    if method in LEARNED:
        from mirror.weights.resolve import WeightResolver

        resolver = WeightResolver({} if weights is None else {method: weights})
        if method == "mvsnet":
            from hybridworldsim.mvs.mvsnet.estimator import MVSNetEstimator

            return MVSNetEstimator.load(resolver, device=device)
        from hybridworldsim.mvs.patchmatchnet.estimator import PatchmatchNetEstimator

        return PatchmatchNetEstimator.load(resolver, device=device)
    if method != "plane-sweep":
        raise UsageError(f"no estimator is called {method!r}", expected="plane-sweep, mvsnet or patchmatchnet")
    if weights is not None:
        raise UsageError("plane-sweep has no weights", remedy="leave --weights out")
    return PlaneSweep(device=device)
