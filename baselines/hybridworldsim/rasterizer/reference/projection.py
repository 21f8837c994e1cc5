"""Projects Gaussians into a camera: ellipses, depths, and which of them reach the image."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from hybridworldsim.rasterizer.lenses import LensDistortion
from hybridworldsim.rasterizer.presets import (
    ALPHA_MIN,
    QUATERNION_MAX,
    QUATERNION_MIN,
    SQUARE_DISCRIMINANT_MIN,
    SQUARE_SIGMAS,
    GsplatPreset,
)
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians
from hybridworldsim.rasterizer.reference.rolling import to_rolling_view
from hybridworldsim.rasterizer.reference.unscented import project_unscented
from hybridworldsim.rasterizer.rolling_shutter import ShutterMotion

RADIUS_MAX = 2**30
"""Upper bound of half extents, pixels: they are int32."""

_CLAMP_MARGIN = 0.3
"""Outside the image, the slope of the projection is clamped at this share of half the field of view."""


class _Splats(NamedTuple):
    """All fields of N Gaussians, culled or not."""

    means2d: Tensor  # (N, 2)
    depths: Tensor  # (N,)
    covariances: Tensor  # (N, 3): xx, xy, yy, blurred
    determinants: Tensor  # (N,), of the blurred covariances
    compensations: Tensor  # (N,)
    sound: Tensor  # (N,) bool: the quaternion is a rotation, and centre and axes are finite in the camera frame
    in_view: Tensor  # (N,) bool: the lens shows the Gaussian


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
    preset: GsplatPreset,
    antialiased: bool,
    lens: LensDistortion | None,
    shutter: ShutterMotion | None = None,
) -> ProjectedGaussians:
    """Project Gaussians into one camera.

    The method is EWA splatting (Zwicker et al. 2001) as in gsplat; with a lens, the unscented transform. Culled
    Gaussians get no gradient. A Gaussian counts for the first cause that culls it, in the order near, far, degenerate
    (a quaternion that is no rotation, a covariance that is no ellipse, a value that is not finite), opacity, radius,
    frustum. A Gaussian with a scale of zero is flat and visible; the sign of a scale has no effect.

    Args:
        means: (N, 3) metres, world.
        quats: (N, 4) wxyz, of any length from `QUATERNION_MIN` to `QUATERNION_MAX`.
        scales: (N, 3) metres.
        opacities: (N,) determine the extent of a Gaussian; no gradient.
        viewmat: (4, 4) camera_SE3_world.
        K: (3, 3) fx, fy, cx, cy in pixels; skew is not used.
        width: width of the image, pixels.
        height: height of the image, pixels.
        eps2d: pixel^2, added to both diagonal elements of a covariance.
        near_plane: metres of camera z; Gaussians at or behind the camera are never visible.
        far_plane: metres of camera z.
        radius_clip: pixels; a Gaussian with both half extents up to this is not visible.
        preset: generation of gsplat.
        antialiased: whether opacities are reduced to compensate the blur.
        lens: None for a pinhole.
        shutter: None for a global shutter; else `viewmat` is the pose at the first row, depths are those at
            mid-readout, and there is a lens.

    Returns:
        The Gaussians that reach the image, in float64; differentiable to means, quats, scales, viewmat and K.
    """
    opacities = opacities.detach().double()
    viewmat, K = viewmat.double(), K.double()

    def splats(rows: Tensor) -> _Splats:
        shape = (means[rows].double(), quats[rows].double(), scales[rows].double())
        return _compute_splats(*shape, viewmat, K, width, height, eps2d, preset, lens, shutter)

    with torch.no_grad():
        candidates = splats(torch.arange(len(means)))
        radii, reach = _compute_radii(candidates, opacities, preset, antialiased)
        x, y = candidates.means2d.unbind(-1)
        remaining = torch.ones_like(candidates.in_view)
        counts = {}
        for cause, culled in (
            ("near", (candidates.depths < near_plane) | (candidates.depths <= 0.0)),
            ("far", candidates.depths > far_plane),
            ("degenerate", ~_is_ellipse(candidates)),
            ("opacity", ~reach),
            ("radius", (radii <= radius_clip).all(-1)),
            (
                "frustum",
                ~candidates.in_view
                | (x + radii[:, 0] <= 0.0)
                | (x - radii[:, 0] >= width)
                | (y + radii[:, 1] <= 0.0)
                | (y - radii[:, 1] >= height),
            ),
        ):
            counts[cause] = int((remaining & culled).sum())
            remaining &= ~culled
        ids = remaining.nonzero()[:, 0]

    visible = splats(ids)
    xx, xy, yy = visible.covariances.unbind(-1)
    with torch.no_grad():
        along = (yy / visible.determinants).sqrt()
        factors = torch.stack([along, -xy / visible.determinants / along, yy.rsqrt()], dim=-1)
    return ProjectedGaussians(
        ids=ids,
        means2d=visible.means2d,
        means2d_low=torch.zeros_like(visible.means2d, requires_grad=False),
        depths=visible.depths,
        conics=torch.stack([yy, -xy, xx], dim=-1) / visible.determinants[:, None],
        factors=factors,
        compensations=visible.compensations if antialiased else None,
        radii=radii[ids].clamp(max=RADIUS_MAX).to(torch.int32),
        counts=counts,
    )


def _compute_splats(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    viewmat: Tensor,
    K: Tensor,
    width: int,
    height: int,
    eps2d: float,
    preset: GsplatPreset,
    lens: LensDistortion | None,
    shutter: ShutterMotion | None,
) -> _Splats:
    rotation = viewmat[:3, :3]
    turned = means @ rotation.T
    rolling = None if shutter is None else to_rolling_view(viewmat, shutter)
    if rolling is None:
        means_c = turned + viewmat[:3, 3]  # (N, 3)
    else:
        means_c = rolling.to_camera(turned, torch.full((len(means),), 0.5, dtype=torch.float64))
    axes_c = rotation @ _to_matrices(quats) * scales[:, None, :]  # (N, 3, 3): one standard deviation a column
    if lens is None:
        means2d, roots = _project_pinhole(means_c, axes_c, K, width, height)
        in_view = torch.ones(len(means), dtype=torch.bool)
    else:
        means2d, roots, in_view = project_unscented(
            means_c if rolling is None else turned, axes_c, K, width, height, lens, rolling
        )

    # The covariance is roots @ roots.T. Its determinant is the sum of the squared minors of `roots` (Cauchy-Binet). The
    # sum is exact for a needle, where xx yy - xy^2 cancels.
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
        in_view=in_view,
    )


def _are_rotations(quats: Tensor) -> Tensor:
    """Return whether quaternions (N, 4) have a length of a rotation (N,)."""
    w, x, y, z = quats.detach().unbind(-1)
    squares = w * w + x * x + y * y + z * z
    return (squares >= QUATERNION_MIN**2) & (squares <= QUATERNION_MAX**2)


def _to_matrices(quats: Tensor) -> Tensor:
    """Convert quaternions (N, 4) to matrices (N, 3, 3); NaN for zero quaternions."""
    w, x, y, z = (quats / quats.norm(dim=-1, keepdim=True)).unbind(-1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


def _project_pinhole(means_c: Tensor, axes_c: Tensor, K: Tensor, width: int, height: int) -> tuple[Tensor, Tensor]:
    """Compute means (N, 2) in pixels and roots (N, 2, 3) of the covariances by the projection's slope at the mean."""
    focal, centre = K.diagonal()[:2], K[:2, 2]
    size = torch.tensor([width, height], dtype=K.dtype)
    slopes = means_c[:, :2] / means_c[:, 2:]  # (N, 2): x / z, y / z
    margin = _CLAMP_MARGIN * 0.5 * size / focal
    clamped = slopes.clamp(-centre / focal - margin, (size - centre) / focal + margin)
    z = means_c[:, 2, None, None]  # (N, 1, 1)
    return focal * slopes + centre, focal[:, None] / z * (axes_c[:, :2] - clamped[:, :, None] * axes_c[:, 2:])


def _is_ellipse(splats: _Splats) -> Tensor:
    """Return whether (N,) a covariance is invertible and all values are finite."""
    fields = (splats.means2d, splats.covariances, splats.determinants[:, None], splats.compensations[:, None])
    finite = splats.sound & torch.cat(fields, dim=-1).isfinite().all(-1)
    return finite & (splats.determinants > 0.0) & (splats.covariances[:, ::2] > 0.0).all(-1)


def _compute_radii(
    splats: _Splats, opacities: Tensor, preset: GsplatPreset, antialiased: bool
) -> tuple[Tensor, Tensor]:
    """Compute half extents (N, 2), whole pixels, and whether (N,) a Gaussian is opaque enough to be visible."""
    diagonal = splats.covariances[:, ::2]  # (N, 2)
    if preset.extent == "square":
        half_trace = diagonal.mean(-1)
        root = (half_trace.square() - splats.determinants).clamp(min=SQUARE_DISCRIMINANT_MIN).sqrt()
        radius = (SQUARE_SIGMAS * (half_trace + root).sqrt()).ceil()
        return torch.stack([radius, radius], dim=-1), torch.ones_like(splats.in_view)
    alphas = opacities * splats.compensations if antialiased else opacities
    sigmas = (2.0 * (alphas / ALPHA_MIN).clamp(min=1.0).log()).sqrt()
    return (sigmas[:, None] * diagonal.sqrt()).ceil(), alphas >= ALPHA_MIN
