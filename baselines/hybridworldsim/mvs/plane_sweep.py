"""Plane-sweep stereo: the depth at which a picture's surroundings look alike in its neighbours. Needs no weights.

Collins, "A space-sweep approach to true multi-image matching" (CVPR 1996), with several sweeping directions (Gallup et
al., "Real-time plane-sweeping stereo with multiple sweeping directions", CVPR 2007): planes that face the camera, along
the road below it, and upright planes along its way, as houses stand. Likeness is the zero-mean normalised
correlation of windows of 5 x 5 px, which exposure, gain and tint do not change. Of a plane's scores over the sources
the mean of the best counts, so that a source in which the point is hidden does not matter (Kang, Szeliski and Chai,
"Handling occlusions in dense multi-view stereo", CVPR 2001). What the windows leave open their neighbours decide: costs
are smoothed along paths, see `path_costs`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybridworldsim.mvs.estimator import DepthMap, PosedPicture
from hybridworldsim.mvs.sweep.planes import Planes, facing_planes, road_planes, upright_planes
from mirror.arrays import Float32, Float64
from mirror.errors import UsageError

_LUMA = (0.299, 0.587, 0.114)
_STEP, _JUMP, _NEUTRAL, _CONTRAST = 8, 48, 100, 0.05


@dataclass(frozen=True)
class PlaneSweep:
    """A `DepthEstimator`. Its results do not depend on the number of threads.

    Memory: beside the pictures 3 bytes a pixel and plane that faces the camera.

    Attributes:
        planes: number of planes that face the camera, evenly spaced in inverse depth: the depths that are told apart
            before they are refined.
        road_planes: number of planes along the road; 0: none.
        upright_planes: number of planes along the way, on each side; 0: none.
        best: how many of the best sources count.
        least_score: correlation below which a depth is unknown.
        least_margin: how much worse all other depths must be, of what four paths cost that differ by 1 in correlation.
        least_deviation: standard deviation of a window, of 1, below which it has no texture.
    """

    planes: int = 128
    road_planes: int = 32
    upright_planes: int = 0
    best: int = 2
    least_score: float = 0.4
    least_margin: float = 0.05
    least_deviation: float = 0.008

    def __call__(
        self, reference: PosedPicture, sources: Sequence[PosedPicture], near_m: float, far_m: float
    ) -> DepthMap:
        """The depth of a picture; see `DepthEstimator`."""
        if not 0.0 < near_m < far_m < np.inf:
            raise UsageError(f"depths from {near_m} to {far_m} m", expected="0 < near_m < far_m, finite")
        if not sources:
            shape = reference.valid.shape
            return DepthMap(np.full(shape, np.nan, np.float32), np.zeros(shape, np.float32))
        from hybridworldsim.mvs.sweep.correlation import COSTS, cost_volume
        from hybridworldsim.mvs.sweep.path_costs import decide, smoothed

        planes = self._planes(reference, sources, near_m, far_m)
        own, span = grey(reference), (1.0 / far_m, 1.0 / near_m)
        volume = cost_volume(
            own,
            [grey(source) for source in sources],
            np.stack([planes.homographies(reference, source) for source in sources]),
            planes.inverse_depth(reference.K),
            span,
            self.planes,
            best=min(self.best, len(sources)),
            deviation=self.least_deviation,
        )
        total = smoothed(volume, own, step=_STEP, jump=_JUMP, neutral=_NEUTRAL, contrast=_CONTRAST)
        half = COSTS / 2.0
        depth, confidence = decide(
            volume, total, reference.valid, *span, half * (1.0 - self.least_score), 4.0 * half * self.least_margin
        )
        return DepthMap(depth, confidence)

    def _planes(self, reference: PosedPicture, sources: Sequence[PosedPicture], near_m: float, far_m: float) -> Planes:
        families = [facing_planes(self.planes, near_m, far_m)]
        if self.road_planes:
            families.append(road_planes(self.road_planes, reference.world_SE3_camera))
        if self.upright_planes:
            families += upright_planes(
                self.upright_planes, reference.world_SE3_camera, [one.world_SE3_camera for one in sources], near_m
            )
        return Planes.together(families)


def grey(picture: PosedPicture) -> Float32:
    """Luma (H, W) of a picture, from -0.5 to 0.5; NaN where it is not valid."""
    luma: Float64 = picture.rgb @ np.array(_LUMA) / 255.0 - 0.5
    return np.where(picture.valid, luma, np.nan).astype(np.float32)
