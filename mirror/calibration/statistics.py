"""How good the calibration of a fleet is: shares with exact bounds, quantiles, and the verdict.

The paper states that 99.7 % of the calibration errors are below 0.3 degrees. Here an error is the total angle between a
delivered mounting and its estimate from images. The cameras of one traversal are not independent (they share poses,
weather and the vehicle), so the verdict counts traversals: one fails if any of its cameras does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
import numpy.typing as npt

from mirror.errors import UsageError
from mirror.installation import install_command

LIMIT_DEG: Final = 0.3
SHARE: Final = 0.997
CONFIDENCE: Final = 0.95

Verdict = Literal["pass", "fail", "too few"]


@dataclass(frozen=True)
class FleetStatistics:
    """Statistics of the estimated errors of a fleet.

    Attributes:
        cameras: number of estimates (a camera in a traversal) with an observable axis.
        cameras_below: how many of them are below the limit.
        samples: number of independent samples: traversals with at least one such estimate.
        samples_below: how many of them have all estimates below the limit.
        vehicles: number of vehicles.
        share_lower: lower bound of the share of samples below the limit (Clopper-Pearson, one-sided).
        share_upper: upper bound of that share.
        median_deg: median angle of the estimates; NaN without estimates.
        robust_quantile_deg: 99.7 % quantile that follows from the median if the errors about the three axes are normal
            and equal (a Maxwell distribution); it does not see outliers.
        empirical_quantile_deg: 99.7 % quantile of the sample; biased low for small samples.
        corrected_rms_deg: root mean square angle after subtraction of the mean variance of the estimates.
        verdict: pass: the lower bound is at least 99.7 %; fail: the upper bound is below; else too few.
        needed: samples without a failure that a pass needs.
    """

    cameras: int
    cameras_below: int
    samples: int
    samples_below: int
    vehicles: int
    share_lower: float
    share_upper: float
    median_deg: float
    robust_quantile_deg: float
    empirical_quantile_deg: float
    corrected_rms_deg: float
    verdict: Verdict
    needed: int


def require_scipy() -> None:
    """Require the package of the extra ``calibration``; called before minutes are spent on images.

    Raises:
        UsageError: scipy is not installed.
    """
    try:
        import scipy  # noqa: F401
    except ModuleNotFoundError as error:
        raise UsageError("calibration needs scipy", remedy=install_command("calibration")) from error


def clopper_pearson(successes: int, samples: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Return the one-sided lower and upper confidence bounds of a share (C. Clopper, E. Pearson 1934).

    Args:
        successes: number of successes, at most ``samples``.
        samples: number of independent samples; without any the bounds are 0 and 1.
        confidence: probability with which each bound holds.

    Raises:
        UsageError: the counts or the confidence are invalid.
    """
    if not (0 <= successes <= samples and 0.0 < confidence < 1.0):
        raise UsageError(f"{successes} of {samples} at {confidence}", expected="0 <= successes <= samples, a share")
    from scipy.stats import beta

    lower = float(beta.ppf(1.0 - confidence, successes, samples - successes + 1)) if successes else 0.0
    upper = float(beta.ppf(confidence, successes + 1, samples - successes)) if successes < samples else 1.0
    return lower, upper


def samples_needed(share: float = SHARE, confidence: float = CONFIDENCE) -> int:
    """Return the number of independent samples, all good, that show a share of good ones with a confidence."""
    return int(np.ceil(np.log(1.0 - confidence) / np.log(share)))


def compute_fleet_statistics(
    traversal: Sequence[str], vehicle: Sequence[str], angle_deg: npt.ArrayLike, sigma_deg: npt.ArrayLike
) -> FleetStatistics:
    """Return the statistics of N estimates.

    Args:
        traversal: N ids: the independent samples.
        vehicle: N ids.
        angle_deg: (N,) angles of the errors.
        sigma_deg: (N,) standard deviations of the angles' vectors: roots of the traces of their covariances.
    """
    from scipy.stats import chi

    angle, sigma = np.asarray(angle_deg, np.float64), np.asarray(sigma_deg, np.float64)
    below = angle < LIMIT_DEG
    ids = np.asarray(traversal)
    unique = np.unique(ids)
    good = int(sum(below[ids == one].all() for one in unique))
    lower, upper = clopper_pearson(good, len(unique))
    empty = not len(angle)
    median = float("nan") if empty else float(np.median(angle))
    excess = float("nan") if empty else float(np.mean(angle**2 - sigma**2))
    verdict: Verdict = "pass" if lower >= SHARE else "fail" if upper < SHARE else "too few"
    return FleetStatistics(
        cameras=len(angle),
        cameras_below=int(below.sum()),
        samples=len(unique),
        samples_below=good,
        vehicles=len(set(vehicle)),
        share_lower=lower,
        share_upper=upper,
        median_deg=median,
        robust_quantile_deg=median * float(chi(3).ppf(SHARE) / chi(3).median()),
        empirical_quantile_deg=float("nan") if empty else float(np.quantile(angle, SHARE)),
        corrected_rms_deg=float("nan") if empty else float(np.sqrt(max(excess, 0.0))),
        verdict=verdict,
        needed=samples_needed(),
    )
