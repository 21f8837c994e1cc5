"""Truth of a synthetic recording for depth maps, points, ground and sky; for benchmarks and tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mirror.arrays import AnyArray, Float64, UInt8
from mirror.geometry.cameras import Camera
from mirror.synth.truth import Truth


@dataclass(frozen=True, eq=False)
class TrueImage:
    """The truth of an image in an undistorted raster.

    Attributes:
        depth_m: (H, W) camera z; infinite in the sky, NaN outside the recorded lens.
        label: (H, W) values of `mirror.synth.model.Label`; 255 outside the recorded lens.
    """

    depth_m: Float64
    label: UInt8


def sample_true_image(truth: Truth, camera: str, timestamp_ns: int, recorded: Camera, lens: Camera) -> TrueImage:
    """Sample the truth of an image at the pixel centres of another lens.

    Args:
        truth: truth of the recording, with depth and semantic labels.
        camera: name of the camera.
        timestamp_ns: recorded timestamp of the image.
        recorded: lens of the recording.
        lens: pinhole lens of the result.
    """
    rays = lens.rays().direction
    distance = resample_nearest(truth.read("depth", camera, timestamp_ns), recorded, lens, np.nan)
    label = resample_nearest(truth.read("semantic", camera, timestamp_ns), recorded, lens, 255)
    return TrueImage(distance * rays[..., 2], label.astype(np.uint8))


def resample_nearest(values: AnyArray, recorded: Camera, lens: Camera, nothing: float) -> AnyArray:
    """Return the values (H, W) of a recorded raster at the pixel centres of another lens; ``nothing`` outside."""
    seen = recorded.project(lens.rays().direction)
    place = np.floor(np.where(seen.valid[..., None], seen.uv_px, 0.0)).astype(np.int64)
    return np.where(seen.valid, values[place[..., 1], place[..., 0]], nothing)
