"""Depth maps as 16-bit PNGs on a logarithmic scale: a constant relative step of 1.8e-4 from 0.1 m to 10 km."""

from __future__ import annotations

from typing import Final

import numpy as np

from mirror.arrays import AnyArray, Float32
from mirror.errors import UsageError
from mirror.recordings.raster import is_decodable

NEAREST_M: Final = 0.1
FARTHEST_M: Final = 10_000.0
_STEPS: Final = 65_535
_LOG_RANGE: Final = float(np.log(FARTHEST_M / NEAREST_M))


def encode_depth(depth_m: AnyArray) -> bytes:
    """Encode depths as a PNG. The relative error after decoding is at most 8.8e-5.

    Args:
        depth_m: (H, W) depth along the camera's z axis; NaN where unknown.

    Raises:
        UsageError: the array is not (H, W), or a depth is outside `NEAREST_M` to `FARTHEST_M`.
    """
    import cv2

    depth = np.asarray(depth_m, np.float64)
    known = ~np.isnan(depth)
    if depth.ndim != 2 or not depth.size:
        raise UsageError(f"depth of shape {depth.shape}", expected="(H, W), not empty")
    if not ((depth[known] >= NEAREST_M) & (depth[known] <= FARTHEST_M)).all():
        raise UsageError(
            f"depths from {depth[known].min():g} to {depth[known].max():g} m",
            expected=f"{NEAREST_M:g} to {FARTHEST_M:g} m, or NaN where unknown",
        )
    steps = np.zeros(depth.shape, np.uint16)
    # Step 0 means unknown, so the smallest depths are stored as step 1.
    steps[known] = np.maximum(np.round(np.log(depth[known] / NEAREST_M) * (_STEPS / _LOG_RANGE)), 1.0)
    return bytes(cv2.imencode(".png", steps)[1])


def decode_depth(data: bytes) -> Float32 | None:
    """Decode depths (H, W) along the camera's z axis in metres, NaN where unknown; None unless a valid 16-bit PNG."""
    import cv2

    steps = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if is_decodable(data) else None
    if steps is None or steps.dtype != np.uint16 or steps.ndim != 2:
        return None
    return _DEPTH_OF_STEP[steps]


def _depth_of_steps() -> Float32:
    depth = NEAREST_M * np.exp(np.arange(_STEPS + 1) * (_LOG_RANGE / _STEPS))
    depth[0] = np.nan
    return depth.astype(np.float32)


_DEPTH_OF_STEP: Final = _depth_of_steps()
