"""Gaussians as a camera sees them: ellipses, their depths, and which of them reach the picture."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from hybridworldsim.rasterizer.lenses import Lens
from hybridworldsim.rasterizer.presets import (
    ALPHA_MIN,
    QUATERNION_MAX,
    QUATERNION_MIN,
    SQUARE_DISCRIMINANT_MIN,
    SQUARE_SIGMAS,
    Preset,
)
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians
from hybridworldsim.rasterizer.reference.unscented import project_unscented

RADIUS_MAX = 2**30
"""Half extents saturate here, pixels: they are int32."""

_CLAMP = 0.3
"""Beside the picture, the slope of the projection is held where this part of half the field of view is passed."""


class _Splats(NamedTuple):
    """Every field of N Gaussians, culled or not."""

    means2d: Tensor  # (N, 2)
    depths: Tensor  # (N,)
    covariances: Tensor  # (N, 3): xx, xy, yy, blurred
    determinants: Tensor  # (N,), of the blurred covariances
    compensations: Tensor  # (N,)
    sound: Tensor  # (N,) bool: whether the quaternion is a rotation, centre and axes are finite in the camera's frame
    seen: Tensor  # (N,) bool: whether the lens shows them


def project(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    viewmat: Tensor,
    K: Tensor,
    width: int,
    height: int,
    *,
    eps2d: float,
    near_plane: float,
    far_plane: float,
    radius_clip: float,
    preset: Preset,
    antialiased: bool,
    lens: Lens | None,
) -> ProjectedGaussians:
    """Project Gaussians into one camera.

    EWA splatting (Zwicker et al. 2001) as gsplat has it; through a lens, the unscented transform. What is culled gets
    no gradient; a Gaussian counts for the first cause that culls it, in the order near, far, degenerate (a quaternion
    that is no rotation, a covariance that is no ellipse, anything not finite), opacity, radius, frustum. A scale of
    zero is a flat Gaussian and is shown; the sign of a scale means nothing.

    Args:
        means: (N, 3) metres, world.
        quats: (N, 4) wxyz, of any length from `QUATERNION_MIN` to `QUATERNION_MAX`.
        scales: (N, 3) metres.
        opacities: (N,) decide how far a Gaussian reaches; no gradient.
        viewmat: (4, 4) camera_SE3_world.
        K: (3, 3) fx, fy, cx, cy in pixels; skew is not used.
        width: pixels.
        height: pixels.
        eps2d: pixel^2 that both diagonal elements of a covariance are blurred by.
        near_plane: metres of camera z; nothing at or behind the camera is ever shown.
        far_plane: metres of camera z.
        radius_clip: a Gaussian whose half extents are both at most so many pixels is not shown.
        preset: whose rules.
        antialiased: whether opacities shrink by what the blur adds.
        lens: None for a pinhole.

    Returns:
        Those that reach the picture, in float64; differentiable to means, quats, scales, viewmat and K.
    """
    opacities = opacities.detach().double()
    viewmat, K = viewmat.double(), K.double()

    def splats(rows: Tensor) -> _Splats:
        shape = (means[rows].double(), quats[rows].double(), scales[rows].double())
        return _splats(*shape, viewmat, K, width, height, eps2d, preset, lens)

    with torch.no_grad():
        every = splats(torch.arange(len(means)))
        radii, reach = _radii(every, opacities, preset, antialiased)
        x, y = every.means2d.unbind(-1)
        left = torch.ones_like(every.seen)
        counts = {}
        for cause, culled in (
            ("near", (every.depths < near_plane) | (every.depths <= 0.0)),
            ("far", every.depths > far_plane),
            ("degenerate", ~_is_ellipse(every)),
            ("opacity", ~reach),
            ("radius", (radii <= radius_clip).all(-1)),
            (
                "frustum",
                ~every.seen
                | (x + radii[:, 0] <= 0.0)
                | (x - radii[:, 0] >= width)
                | (y + radii[:, 1] <= 0.0)
                | (y - radii[:, 1] >= height),
            ),
        ):
            counts[cause] = int((left & culled).sum())
            left &= ~culled
        ids = left.nonzero()[:, 0]

    shown = splats(ids)
    xx, xy, yy = shown.covariances.unbind(-1)
    with torch.no_grad():
        along = (yy / shown.determinants).sqrt()
        factors = torch.stack([along, -xy / shown.determinants / along, yy.rsqrt()], dim=-1)
    return ProjectedGaussians(
        ids=ids,
        means2d=shown.means2d,
        means2d_low=torch.zeros_like(shown.means2d, requires_grad=False),
        depths=shown.depths,
        conics=torch.stack([yy, -xy, xx], dim=-1) / shown.determinants[:, None],
        factors=factors,
        compensations=shown.compensations if antialiased else None,
        radii=radii[ids].clamp(max=RADIUS_MAX).to(torch.int32),
        counts=counts,
    )


def _splats(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    viewmat: Tensor,
    K: Tensor,
    width: int,
    height: int,
    eps2d: float,
    preset: Preset,
    lens: Lens | None,
) -> _Splats:
    rotation = viewmat[:3, :3]
    means_c = means @ rotation.T + viewmat[:3, 3]  # (N, 3)
    axes_c = rotation @ _rotations(quats) * scales[:, None, :]  # (N, 3, 3): one standard deviation a column
    if lens is None:
        means2d, roots = _perspective(means_c, axes_c, K, width, height)
        seen = torch.ones(len(means), dtype=torch.bool)
    else:
        means2d, roots, seen = project_unscented(means_c, axes_c, K, width, height, lens)

    # The covariance is roots @ roots.T; its determinant, the sum of the squared minors of `roots` (Cauchy-Binet),
    # keeps every digit of a needle's, which xx yy - xy^2 loses.
    covariances = roots @ roots.mT  # (N, 2, 2)
    xx, xy, yy = covariances[:, 0, 0], covariances[:, 0, 1], covariances[:, 1, 1]
    minors = roots[:, 0, :, None] * roots[:, 1, None, :]  # (N, k, k)
    sharp = 0.5 * (minors - minors.mT).square().sum((-1, -2))
    blurred = sharp + eps2d * (xx + yy) + eps2d**2

    ratio = sharp / blurred
    free = ratio > preset.compensation_min**2
    return _Splats(
        means2d=means2d,
        depths=means_c[:, 2],
        covariances=torch.stack([xx + eps2d, xy, yy + eps2d], dim=-1),
        determinants=blurred,
        # the inner `where` keeps the infinite slope of the root at zero out of the gradient
        compensations=torch.where(free, torch.where(free, ratio, 1.0).sqrt(), preset.compensation_min),
        sound=_are_rotations(quats) & torch.cat([means_c[:, None], axes_c], dim=1).isfinite().all((1, 2)),
        seen=seen,
    )


def _are_rotations(quats: Tensor) -> Tensor:
    """Whether quaternions (N, 4) have a length (N,) that counts."""
    w, x, y, z = quats.detach().unbind(-1)
    squares = w * w + x * x + y * y + z * z
    return (squares >= QUATERNION_MIN**2) & (squares <= QUATERNION_MAX**2)


def _rotations(quats: Tensor) -> Tensor:
    """Quaternions (N, 4) as matrices (N, 3, 3); NaN for those of zero."""
    w, x, y, z = (quats / quats.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


def _perspective(means_c: Tensor, axes_c: Tensor, K: Tensor, width: int, height: int) -> tuple[Tensor, Tensor]:
    """Means (N, 2) in pixels and roots (N, 2, 3) of the covariances, by the projection's slope at the mean."""
    focal, centre = K.diagonal()[:2], K[:2, 2]
    size = torch.tensor([width, height], dtype=K.dtype)
    slopes = means_c[:, :2] / means_c[:, 2:]  # (N, 2): x / z, y / z
    beside = _CLAMP * 0.5 * size / focal
    held = slopes.clamp(-centre / focal - beside, (size - centre) / focal + beside)
    z = means_c[:, 2, None, None]  # (N, 1, 1)
    return focal * slopes + centre, focal[:, None] / z * (axes_c[:, :2] - held[:, :, None] * axes_c[:, 2:])


def _is_ellipse(splats: _Splats) -> Tensor:
    """Whether (N,) a covariance can be inverted and all else is finite."""
    fields = (splats.means2d, splats.covariances, splats.determinants[:, None], splats.compensations[:, None])
    finite = splats.sound & torch.cat(fields, dim=-1).isfinite().all(-1)
    return finite & (splats.determinants > 0.0) & (splats.covariances[:, ::2] > 0.0).all(-1)


def _radii(splats: _Splats, opacities: Tensor, preset: Preset, antialiased: bool) -> tuple[Tensor, Tensor]:
    """Half the extents (N, 2), whole pixels, and whether (N,) a Gaussian is opaque enough to be seen at all."""
    diagonal = splats.covariances[:, ::2]  # (N, 2)
    if preset.extent == "square":
        half_trace = diagonal.mean(-1)
        root = (half_trace.square() - splats.determinants).clamp(min=SQUARE_DISCRIMINANT_MIN).sqrt()
        radius = (SQUARE_SIGMAS * (half_trace + root).sqrt()).ceil()
        return torch.stack([radius, radius], dim=-1), torch.ones_like(splats.seen)
    compute_alphas = opacities * splats.compensations if antialiased else opacities
    sigmas = (2.0 * (compute_alphas / ALPHA_MIN).clamp(min=1.0).log()).sqrt()
    return (sigmas[:, None] * diagonal.sqrt()).ceil(), compute_alphas >= ALPHA_MIN
