"""The height of a camera above the road by a sweep of planes: for roads with too few features of their own.

Between the wheels, the pixels of one image are laid on a plane below the way and looked up in an earlier image. Of the
right plane both show the same: the correlation of the two, without slow changes of brightness, is largest there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float32, Float64, UInt8
from mirror.geometry import Poses, matrix_from_quaternion
from mirror.geometry.cameras import Camera
from mirror.localisation.structure.road import RoadHeight

GreyImage = tuple[UInt8, Bool]
"""An image (H, W) and which of its pixels are static."""

_NEAREST, _FARTHEST = 2.2, 9.0
"""The patch ahead of the later camera, in heights of the camera: nearer the image ends, farther it is too flat."""
_HALF_WIDTH: Final = 0.6
"""Between the wheels, in heights of the camera."""
_ROWS, _COLUMNS = 48, 24
_LOWEST, _HIGHEST = 0.12, 6.0
"""Heights that are tried, in median steps between the images."""
_STEP: Final = 0.015
_BLUR_SHARE: Final = 0.02
_LEAST_SHARE: Final = 0.3
_LEAST_PAIRS: Final = 8
_LEAST_SCORE: Final = 0.2
_LEAST_LEAD: Final = 0.1
"""The correlation of the road must stand out from both sides by this."""
_NEAR: Final = 0.12
"""Half width of the peak, in logarithms of the height."""
_PARTS: Final = 6


def sweep_road(poses: Poses, up: Float64, lens: Camera, read: Callable[[int], GreyImage]) -> RoadHeight | None:
    """Measure the height of a camera above the road that it drives over.

    Args:
        poses: N poses of the camera along its way.
        up: (3,) mean vertical.
        lens: its lens.
        read: reads the image of a pose by its row.

    Returns:
        The height in units of the poses, its 1-sigma from parts of the drive, and the number of pairs of images; None:
        no plane shows the same in both images of enough pairs.
    """
    from scipy.signal import find_peaks

    steps = np.linalg.norm(np.diff(poses.translation, axis=0), axis=1)
    moving = np.flatnonzero(steps > 0.3 * np.median(steps))
    median = float(np.median(steps[moving]))
    logs = np.arange(np.log(_LOWEST * median), np.log(_HIGHEST * median), _STEP)
    heights = np.exp(logs)
    scores, last = [], (-1, np.zeros((0, 0), np.float32))
    for row in moving.tolist():
        first = last[1] if last[0] == row else _details(*read(row))
        second = _details(*read(row + 1))
        last = row + 1, second
        pair = poses[np.array([row, row + 1])]
        scores.append([_correlation(pair, up, lens, first, second, height) for height in heights.tolist()])
    table = np.array(scores).reshape(-1, len(heights))
    known = np.isfinite(table)
    enough = known.sum(axis=0) >= max(_LEAST_PAIRS, len(table) // 3)
    if not enough.any():
        return None
    mean = np.nanmean(np.where(known, table, np.nan)[:, enough], axis=0)
    logs, table, known = logs[enough], table[:, enough], known[:, enough]
    # Of a plane far below, both images show the same because it hardly moves: the road is a peak, not a rise.
    peaks, found = find_peaks(mean, height=_LEAST_SCORE, prominence=_LEAST_LEAD)
    if not len(peaks):
        return None
    best = int(peaks[np.argmax(found["prominences"])])
    near = np.flatnonzero(np.abs(logs - logs[best]) <= _NEAR)
    pairs = np.flatnonzero(known[:, near].all(axis=1))
    parts = [part for part in np.array_split(pairs, _PARTS) if len(part)]
    own = [_peak(table[np.ix_(part, near)].mean(axis=0), logs[near]) for part in parts]
    height = float(np.exp(_peak(mean[near], logs[near])))
    sigma = float(np.std(own) / np.sqrt(len(own))) if len(own) > 1 else _STEP
    return RoadHeight(height, height * sigma, len(pairs))


def _peak(scores: Float64, logs: Float64) -> float:
    """Return where scores are largest, between the samples by a parabola."""
    best = int(np.argmax(scores))
    if not 0 < best < len(scores) - 1:
        return float(logs[best])
    before, here, after = scores[best - 1 : best + 2]
    curve = before - 2.0 * here + after
    shift = 0.5 * (before - after) / curve if curve < 0.0 else 0.0
    return float(logs[best] + shift * (logs[1] - logs[0]))


def _details(grey: UInt8, still: Bool) -> Float32:
    """Return an image without its slow changes of brightness; NaN where it is not static."""
    import cv2

    values = grey.astype(np.float32)
    blurred = cv2.GaussianBlur(values, (0, 0), _BLUR_SHARE * grey.shape[1])
    return np.where(still, values - blurred, np.float32(np.nan))


def _correlation(pair: Poses, up: Float64, lens: Camera, first: Float32, second: Float32, height: float) -> float:
    """Return the correlation of two images on a plane below the way; NaN where too little of it is seen by both."""
    import cv2

    start, end = pair.translation
    ahead = (end - start) / np.linalg.norm(end - start)
    upright = up - (up @ ahead) * ahead
    upright /= np.linalg.norm(upright)
    left = np.cross(upright, ahead)
    # Even steps in the image: rows far away are as tall as near ones.
    along = 1.0 / np.linspace(1.0 / _FARTHEST, 1.0 / _NEAREST, _ROWS)
    across = np.linspace(-_HALF_WIDTH, _HALF_WIDTH, _COLUMNS)
    points = end + height * (
        along[:, None, None] * ahead + across[None, :, None] * left - np.ones((_ROWS, _COLUMNS, 1)) * upright
    )
    seen = []
    for place, image in ((0, first), (1, second)):
        turn = matrix_from_quaternion(pair.rotation[place : place + 1])[0]
        uv = lens.project((points.reshape(-1, 3) - pair.translation[place]) @ turn).uv_px.astype(np.float32) - 0.5
        maps = np.nan_to_num(uv, nan=-1e6).reshape(_ROWS, _COLUMNS, 2)
        seen.append(
            cv2.remap(image, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT,
                      borderValue=float("nan"))
        )  # fmt: skip
    both = np.isfinite(seen[0]) & np.isfinite(seen[1])
    if both.mean() < _LEAST_SHARE:
        return float("nan")
    one, other = (values[both] - values[both].mean() for values in seen)
    size = float(np.sqrt((one**2).sum() * (other**2).sum()))
    return float((one * other).sum() / size) if size > 0.0 else float("nan")
