"""An estimator of a level road."""

from __future__ import annotations

import numpy as np

from hybridworldsim.mvs.estimator import DepthMap, StereoImage

CAMERAS = ("front_wide", "front_left")
"""Cameras of the dataset of the fixtures."""


class LevelRoad:
    """Returns the depth of a level road for each pixel below the horizon, without sources."""

    calls = 0

    def __repr__(self) -> str:
        return "LevelRoad()"

    def __call__(self, reference: StereoImage, sources: object, near_m: float, far_m: float) -> DepthMap:
        return self.estimate(reference, near_m, far_m)

    def estimate(self, reference: StereoImage, near_m: float, far_m: float) -> DepthMap:
        self.calls += 1
        height, width = reference.valid.shape
        u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(reference.K).T
        pose = reference.world_SE3_camera.matrix()[0]
        depth = -pose[2, 3] / (rays @ pose[2, :3])
        known = (depth > near_m) & (depth < far_m)
        return DepthMap(np.where(known, depth, np.nan).astype(np.float32), known.astype(np.float32))
