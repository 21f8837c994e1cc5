"""The estimators of depth by name."""

from __future__ import annotations

from hybridworldsim.mvs.estimator import DepthEstimator
from hybridworldsim.mvs.plane_sweep import PlaneSweep
from mirror.errors import UsageError


def estimator_of(method: str, weights: str | None) -> tuple[DepthEstimator, dict[str, str]]:
    """An estimator and the hashes of what it is made of.

    Args:
        method: its name.
        weights: path of its weights, where it has some.

    Raises:
        UsageError: there is no such method, or it takes no weights.
    """
    if method == "plane-sweep":
        if weights is not None:
            raise UsageError("plane-sweep has no weights", remedy="leave --weights out")
        return PlaneSweep(), {"estimator": repr(PlaneSweep())}
    raise UsageError(f"there is no method {method!r}", expected="plane-sweep")
