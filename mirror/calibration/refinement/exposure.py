"""When the features of rolling shutters are seen, and their rays as they would be at mid-exposure.

A feature is seen at the time of its line, from where the vehicle's velocities have moved the camera then. The ray by
which its point, as far as it is known, would be seen at mid-exposure replaces its own. The derivatives of the residual
by the times of the camera say what a later line changes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mirror.arrays import Float64
from mirror.calibration.equations import exp_rotations, line_shares, rays_with_slopes
from mirror.calibration.refinement.equations import TIMES
from mirror.calibration.refinement.rigs import FeatureTracks, MovingRigs


@dataclass(frozen=True, eq=False)
class ExposedFeatures:
    """The rays of M features.

    Attributes:
        seen: (M, 3) unit rays at the times of the features' lines.
        ray: (M, 3) rays at mid-exposure.
        metric: (M, 2, 3) derivatives of pixels by rays.
        from_centre: (M, 2) features relative to the principal points.
        shares: (M, 3) derivatives of the time of a feature by the times of its camera.
        late: (M, 2, E) derivatives of the residuals by these times, pixels a second; E is 0 where they are known.
        times_s: (K, 3) times of the cameras that `ray` and `late` belong to.
    """

    seen: Float64
    ray: Float64
    metric: Float64
    from_centre: Float64
    shares: Float64
    late: Float64
    times_s: Float64

    @classmethod
    def of(cls, rigs: MovingRigs, tracks: FeatureTracks) -> ExposedFeatures:
        """Return the features of tracks, all of them as seen at mid-exposure."""
        mounting = rigs.mounting[tracks.image]
        ray, metric, shares = np.empty((len(mounting), 3)), np.empty((len(mounting), 2, 3)), np.ones((len(mounting), 3))
        for number in np.unique(mounting):
            own, camera = mounting == number, rigs.cameras[number]
            ray[own], slopes = rays_with_slopes(camera, tracks.uv_px[own])
            metric[own] = np.linalg.pinv(slopes)
            shares[own, 1:] = line_shares(camera, tracks.uv_px[own])
        centres = np.array([(camera.cx_px, camera.cy_px) for camera in rigs.cameras])
        late = np.zeros((len(mounting), 2, 0))
        times_s = np.zeros((len(rigs.cameras), TIMES))
        return cls(ray, ray, metric, tracks.uv_px - centres[mounting], shares, late, times_s)

    def exposed(
        self,
        twist: Float64,
        in_ego: Float64,
        mount_turns: Float64,
        mount_places: Float64,
        mounting: np.ndarray[tuple[int], np.dtype[np.int64]],
        times_s: Float64,
        *,
        are_unknown: bool,
    ) -> ExposedFeatures:
        """Return the features with the rays by which their points would be seen at mid-exposure.

        Args:
            twist: (M, 6) velocities of the vehicle, rad/s and m/s in its own frame.
            in_ego: (M, 3) points in the vehicle's frame at mid-exposure.
            mount_turns: (K, 3, 3) rotations ego_R_camera.
            mount_places: (K, 3) positions of the cameras on the vehicle.
            mounting: (M,) camera of each feature.
            times_s: (K, 3) times of the cameras.
            are_unknown: whether the derivatives by the times are needed.
        """
        when = (self.shares * times_s[mounting]).sum(axis=1)
        spin, speed = twist[:, :3], twist[:, 3:]
        moves = exp_rotations(when[:, None] * spin)
        later = np.einsum("mji,mj->mi", moves, in_ego - when[:, None] * speed)
        turns = mount_turns[mounting]
        (middle, _), (direction, distance) = (
            _directions(np.einsum("mji,mj->mi", turns, place - mount_places[mounting])) for place in (in_ego, later)
        )
        late = np.zeros((len(when), 2, 0))
        if are_unknown:
            passing = -np.cross(spin, later) - np.einsum("mji,mj->mi", moves, speed)
            passing = np.einsum("mji,mj->mi", turns, passing) / distance
            passing -= (passing * direction).sum(axis=1, keepdims=True) * direction
            late = np.einsum("mab,mb->ma", self.metric, passing)[:, :, None] * self.shares[:, None]
        return replace(self, ray=self.seen + middle - direction, late=late, times_s=times_s)


def _directions(places: Float64) -> tuple[Float64, Float64]:
    """Unit vectors (M, 3) and lengths (M, 1)."""
    length = np.linalg.norm(places, axis=1, keepdims=True)
    return places / length, length
