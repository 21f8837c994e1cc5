"""Readouts and time offsets of cameras, from points that many images of all cameras see.

A pair of images of one camera hardly tells a later row from another depth; a point that three images or another camera
see too has one depth. The adjustment is repeated with the times of the cameras as unknowns.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mirror.calibration.refinement.adjustment import adjust_rigs
from mirror.calibration.refinement.rigs import FeatureTracks, MovingRigs, RefinementPrior
from mirror.calibration.rig import TimePrior
from mirror.calibration.shutters import ShutterEstimate, describe_times
from mirror.geometry.rolling_shutter import RollingShutter


def estimate_times(
    rigs: MovingRigs,
    tracks: FeatureTracks,
    names: Sequence[str],
    prior: RefinementPrior | None = None,
    advance: Callable[[int], None] = lambda steps: None,
    times: TimePrior | None = None,
) -> list[ShutterEstimate]:
    """Estimate readout and time offset of every mounting, jointly with mountings, lenses, poses and points.

    Args:
        rigs: the recorded rigs, with the vehicle's velocities.
        tracks: tracks of features.
        names: K names of the cameras.
        prior: errors that the recorded values may have; None: the defaults.
        advance: is called with 1 after each step.
        times: errors that the declared times may have; None: the defaults.

    Returns:
        One estimate per mounting. The standard deviations are those of the sandwich covariance with the tracks as
        clusters; where the images do not show a time, they are those of the prior.

    Raises:
        UsageError: no track can be triangulated, or the rigs state no velocities.
    """
    found = adjust_rigs(rigs, tracks, prior, advance, times=times or TimePrior())
    variance = np.diagonal(found.covariance)
    out = []
    for number, (name, camera) in enumerate(zip(names, rigs.cameras, strict=True)):
        undeclared = RollingShutter("global", 0, camera.width_px, camera.height_px)
        shutter = rigs.shutters[number] if rigs.shutters else undeclared
        sigma_s = np.sqrt(variance[found.time_columns(number)])
        out.append(describe_times(name, shutter, found.state.times_s[number], sigma_s))
    return out
