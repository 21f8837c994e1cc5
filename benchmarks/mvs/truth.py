"""What a synthetic recording's truth says of depth maps, points, ground and sky; for benchmarks and tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mirror.arrays import AnyArray, Float64, UInt8
from mirror.geometry.cameras import Camera
from mirror.synth.truth import Truth


@dataclass(frozen=True, eq=False)
class TruePicture:
    """The truth of an image in an undistorted raster.

    Attributes:
        depth_m: (H, W) camera z; infinite in the sky, NaN where the lens sees nothing.
        label: (H, W) values of `mirror.synth.model.Label`; 255 where the lens sees nothing.
    """

    depth_m: Float64
    label: UInt8


def true_picture(truth: Truth, camera: str, timestamp_ns: int, recorded: Camera, lens: Camera) -> TruePicture:
    """The truth of one image, looked up where each pixel's centre looks.

    Args:
        truth: of its recording, with depth and semantic.
        camera: its camera.
        timestamp_ns: its recorded stamp.
        recorded: the lens that it was recorded through.
        lens: the pinhole whose raster is wanted.
    """
    rays = lens.rays().direction
    distance = looked_up(truth.read("depth", camera, timestamp_ns), recorded, lens, np.nan)
    label = looked_up(truth.read("semantic", camera, timestamp_ns), recorded, lens, 255)
    return TruePicture(distance * rays[..., 2], label.astype(np.uint8))


def looked_up(values: AnyArray, recorded: Camera, lens: Camera, nothing: float) -> AnyArray:
    """The values (H, W) of a recorded raster where each pixel's centre of another lens looks; else ``nothing``."""
    seen = recorded.project(lens.rays().direction)
    place = np.floor(np.where(seen.valid[..., None], seen.uv_px, 0.0)).astype(np.int64)
    return np.where(seen.valid, values[place[..., 1], place[..., 0]], nothing)
