"""Errors of the estimated readouts and time offsets, beside the least that any estimate can reach.

Three cameras on a bend of 5.6 s with up to 40 degrees a second (`tests.calibration.rolling_rig`), readouts of 20 to 30
ms and a clock that is 6 ms late. The bound is Cramer and Rao's: the inverse of the information of the features, the
points eliminated, and of the priors. It is computed for pairs of images, whose points have a depth each, for tracks of
one camera, and for tracks of all cameras. The bar: 1 ms, in every camera.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from benchmarks.report import Row
from mirror.arrays import Float64
from mirror.calibration.refinement.adjustment import Adjuster, adjust_rigs
from mirror.calibration.refinement.rigs import FeatureTracks, MovingRigs, RefinementPrior
from mirror.calibration.refinement.shutters import estimate_times
from mirror.calibration.rig import TimePrior
from mirror.calibration.shutters import ShutterEstimate, estimate_shutters
from tests.calibration.exact_rig import CAMERAS
from tests.calibration.rolling_rig import TRUE, rolling_features, rolling_rig

BAR_MS: Final = 1.0
OFFSET_MS: Final = 6.0
NOISE_PX: Final = (0.15, 0.4)
_POINTS: Final = 900
_SETTLED: Final = RefinementPrior(focal_share=5e-3)
"""Focal lengths that are known to 0.5 %, as in the check."""


def shutter_rows(draws: int) -> Iterator[Row]:
    """Yield bounds, errors and covered intervals by camera."""
    exact = {alone: rolling_features(TRUE, OFFSET_MS, points=_POINTS, alone=alone) for alone in (False, True)}
    features = {
        "pairs of images": (exact[True][0], pairs_of(*exact[True])),
        "tracks of one camera": exact[True],
        "tracks of all cameras": exact[False],
    }
    for noise_px in NOISE_PX:
        for name, (rigs, tracks) in features.items():
            bounds = time_bounds_ms(rigs, tracks, noise_px)
            size = f"{len(tracks.image)} features, {noise_px:g} px"
            for camera, (offset, readout) in zip(CAMERAS, bounds.tolist(), strict=True):
                yield Row(
                    f"{camera}, {name}: bound of the readout (ms)", size, readout, offset, unit="ms of the offset"
                )
    for noise_px in NOISE_PX:

        def from_tracks(seed: int, noise_px: float = noise_px) -> list[ShutterEstimate]:
            found = rolling_features(TRUE, OFFSET_MS, noise_px, points=_POINTS, seed=seed)
            return estimate_times(*found, list(CAMERAS), _SETTLED)

        yield from _error_rows(f"refine (tracks), {noise_px:g} px", draws, from_tracks, BAR_MS)
    for noise_px in NOISE_PX:

        def from_pairs(seed: int, noise_px: float = noise_px) -> list[ShutterEstimate]:
            return estimate_shutters(rolling_rig(TRUE, OFFSET_MS, noise_px, noise_seed=seed))

        yield from _error_rows(f"check (pairs), {noise_px:g} px", draws, from_pairs, None)


def pairs_of(rigs: MovingRigs, tracks: FeatureTracks) -> FeatureTracks:
    """Split tracks of single cameras into pairs of neighbouring images, each with a point of its own."""
    frame = rigs.frame[tracks.image]
    first = np.flatnonzero((np.diff(tracks.track) == 0) & (np.diff(frame) == 1))
    rows = np.stack([first, first + 1], axis=1).ravel()
    number = np.repeat(np.arange(len(first)), 2)
    return FeatureTracks(number, tracks.image[rows], tracks.uv_px[rows], tracks.scale_px[rows])


def time_bounds_ms(rigs: MovingRigs, tracks: FeatureTracks, noise_px: float) -> Float64:
    """Return the least standard deviations (C, 2) of offset and readout that exact features with some noise allow."""
    # residuals of exact features are 0: the weights of the loss are the inverse variances of the noise
    prior = replace(_SETTLED, feature_px=0.5 * noise_px)
    found = adjust_rigs(rigs, tracks, prior, times=TimePrior())
    adjuster = Adjuster(rigs, prior, TimePrior())
    adjuster.expose(found.state, found.tracks)
    matrix, *_ = adjuster._equations(found.state, found.tracks, np.full(len(found.tracks.image), noise_px), 0.0)
    sigma_ms = 1e3 * np.sqrt(np.diagonal(np.linalg.inv(matrix + adjuster.information)))
    return np.stack([sigma_ms[found.time_columns(number)][_columns(name)] for number, name in enumerate(CAMERAS)])


def _columns(camera: str) -> list[int]:
    """Columns of the offset and of the readout in the true direction among the times of a camera."""
    return [0, 2 if TRUE[camera].reads_columns else 1]


def _error_rows(
    what: str, draws: int, estimate: Callable[[int], list[ShutterEstimate]], bar: float | None
) -> Iterator[Row]:
    errors, sigma = np.empty((draws, len(CAMERAS), 2)), np.empty((draws, len(CAMERAS), 2))
    for draw in range(draws):
        for number, one in enumerate(estimate(draw)):
            errors[draw, number] = one.offset_ms - OFFSET_MS, one.readout_ms - 1e-6 * TRUE[one.camera].readout_ns
            sigma[draw, number] = one.offset_sigma_ms, one.readout_sigma_ms
    for number, camera in enumerate(CAMERAS):
        for column, time in enumerate(("offset", "readout")):
            own, size = np.abs(errors[:, number, column]), f"{draws} draws"
            rms, stated = float(np.sqrt((own**2).mean())), float(np.median(sigma[:, number, column]))
            yield Row(f"{camera}, {what}: {time}, rms (ms)", size, rms, float(own.max()),
                      unit=f"ms worst; stated {stated:.2f}", bar=bar)  # fmt: skip
    inside = np.abs(errors) < 2.0 * sigma
    yield Row(f"{what}: errors beyond two deviations (share)", f"{inside.size} values", float(1.0 - inside.mean()),
              float((np.abs(errors) / sigma).max()), unit="deviations worst", bar=0.1)  # fmt: skip
