"""Plane-sweep stereo: finds the depth at which the window around a pixel correlates with its neighbours, no weights.

Collins, "A space-sweep approach to true multi-image matching" (CVPR 1996), with several sweeping directions (Gallup et
al., "Real-time plane-sweeping stereo with multiple sweeping directions", CVPR 2007): planes that face the camera,
level planes of the road, and upright planes along the motion, as facades. The score is the zero-mean normalised
correlation of windows of 5 x 5 px; exposure, gain and tint do not change it. The mean of a plane's best scores over the
sources counts, so that a source in which the point is occluded does not matter (Kang, Szeliski and Chai, "Handling
occlusions in dense multi-view stereo", CVPR 2001). The costs are then smoothed along paths, see `path_costs`, so that
neighbours decide where windows are ambiguous.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from hybridworldsim.kernels.dispatch import runs_kernels
from hybridworldsim.mvs.estimator import DepthMap, StereoImage, make_unknown_depth, require_depth_range
from hybridworldsim.mvs.sweep.planes import Planes, make_facing_planes, make_road_planes, make_upright_planes
from mirror.arrays import AnyArray, Float32, Float64
from mirror.devices import CPU

_LUMA = (0.299, 0.587, 0.114)
_STEP, _JUMP, _NEUTRAL, _CONTRAST = 8, 48, 100, 0.05
_PLAIN_BYTES = 17
"""Of plain torch, per pixel and facing plane: the costs, their sums, and the copies of both directions."""
_PLAIN_WARPED = 1 << 29


@dataclass(frozen=True)
class PlaneSweep:
    """A `DepthEstimator` by plane sweep. Its results do not depend on the number of threads.

    The CPU runs compiled kernels, other devices plain torch. Memory: 3 bytes per pixel and facing plane, and the
    images; in plain torch see `estimate_bytes`.

    Attributes:
        planes: number of planes that face the camera, evenly spaced in inverse depth: the resolution of depth before
            the refinement.
        road_planes: number of level planes; 0: none.
        upright_planes: number of upright planes on each side; 0: none.
        best: number of best sources that count.
        least_score: correlation below which a depth is unknown.
        least_margin: least distance to the cost of all other depths, as a share of the cost that a difference of 1 in
            correlation makes over four paths.
        least_deviation: standard deviation of grey values in a window, of a range of 1, below which the window has no
            texture.
        device: where it computes, as torch names it; results of a GPU differ in the last digits.
    """

    planes: int = 128
    road_planes: int = 32
    upright_planes: int = 0
    best: int = 2
    least_score: float = 0.4
    least_margin: float = 0.05
    least_deviation: float = 0.008
    device: str = field(default=CPU, repr=False)

    def __call__(self, reference: StereoImage, sources: Sequence[StereoImage], near_m: float, far_m: float) -> DepthMap:
        """Estimate the depth of an image; see `DepthEstimator`."""
        require_depth_range(near_m, far_m)
        if not sources:
            return make_unknown_depth(reference)
        planes = self._make_planes(reference, sources, near_m, far_m)
        sweep = self._sweep_compiled if runs_kernels(self.device) else self._sweep_elsewhere
        return sweep(reference, sources, planes, (1.0 / far_m, 1.0 / near_m))

    def _sweep_compiled(
        self, reference: StereoImage, sources: Sequence[StereoImage], planes: Planes, inverse_range: tuple[float, float]
    ) -> DepthMap:
        """Sweep the planes by compiled kernels."""
        from hybridworldsim.mvs.sweep.correlation import compute_cost_volume
        from hybridworldsim.mvs.sweep.path_costs import select_depths, smooth_costs

        grey = to_grey(reference)
        volume = compute_cost_volume(
            grey,
            [to_grey(source) for source in sources],
            np.stack([planes.compute_homographies(reference, source) for source in sources]),
            planes.compute_inverse_depth(reference.K),
            inverse_range,
            self.planes,
            best=min(self.best, len(sources)),
            deviation=self.least_deviation,
        )
        total = smooth_costs(volume, grey, step=_STEP, jump=_JUMP, neutral=_NEUTRAL, contrast=_CONTRAST)
        return DepthMap(*select_depths(volume, total, reference.valid, *inverse_range, *self._limits()))

    def _sweep_elsewhere(
        self, reference: StereoImage, sources: Sequence[StereoImage], planes: Planes, inverse_range: tuple[float, float]
    ) -> DepthMap:
        """Sweep the planes in plain torch on the device."""
        import torch

        from hybridworldsim.mvs.plain.sweep import compute_cost_volume, select_depths, smooth_costs

        def move(array: AnyArray) -> torch.Tensor:
            return torch.from_numpy(np.ascontiguousarray(array)).to(self.device)

        grey = move(to_grey(reference))
        volume = compute_cost_volume(
            grey,
            [move(to_grey(source)) for source in sources],
            move(np.stack([planes.compute_homographies(reference, source) for source in sources])),
            move(planes.compute_inverse_depth(reference.K)),
            inverse_range,
            self.planes,
            best=min(self.best, len(sources)),
            deviation=self.least_deviation,
        )
        total = smooth_costs(volume, grey, step=_STEP, jump=_JUMP, neutral=_NEUTRAL, contrast=_CONTRAST)
        found = select_depths(volume, total, move(reference.valid), *inverse_range, *self._limits())
        return DepthMap(*(part.cpu().numpy() for part in found))

    def _limits(self) -> tuple[float, float]:
        """Return the greatest cost of a known depth, and the least margin of its sum over the paths."""
        from hybridworldsim.mvs.sweep.correlation import COSTS

        half = COSTS / 2.0
        return half * (1.0 - self.least_score), 4.0 * half * self.least_margin

    def _make_planes(
        self, reference: StereoImage, sources: Sequence[StereoImage], near_m: float, far_m: float
    ) -> Planes:
        """Make the planes that are swept."""
        families = [make_facing_planes(self.planes, near_m, far_m)]
        if self.road_planes:
            families.append(make_road_planes(self.road_planes, reference.world_SE3_camera))
        if self.upright_planes:
            families += make_upright_planes(
                self.upright_planes, reference.world_SE3_camera, [source.world_SE3_camera for source in sources], near_m
            )
        return Planes.concatenate(families)


def to_grey(image: StereoImage) -> Float32:
    """Compute the luma (H, W) of an image, from -0.5 to 0.5; NaN at invalid pixels."""
    luma: Float64 = image.rgb @ np.array(_LUMA) / 255.0 - 0.5
    return np.where(image.valid, luma, np.nan).astype(np.float32)


def estimate_bytes(width_px: int) -> int:
    """Estimate the memory, in bytes, of a `PlaneSweep` in plain torch, if images are square at most."""
    return _PLAIN_BYTES * PlaneSweep.planes * width_px**2 + _PLAIN_WARPED
