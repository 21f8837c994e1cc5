"""Exports a street as vanilla 3D Gaussian Splatting, for viewers that cannot decode codes: one drive, one camera."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from hybridworldsim.model.blocks import Block
from hybridworldsim.model.composition import Composition
from hybridworldsim.model.nodes.anchors import Anchors
from hybridworldsim.model.nodes.code_gaussians import CodeGaussians
from hybridworldsim.model.nodes.gaussian_assembly import GEOMETRY
from hybridworldsim.model.parts import MIN_WEIGHT, LatentSelector, split_street
from hybridworldsim.model.street import StreetModel
from hybridworldsim.model.visible import select_visible
from hybridworldsim.rasterizer import rasterization
from hybridworldsim.rasterizer.reference.spherical_harmonics import spherical_harmonics
from hybridworldsim.trainable.viewpoint import Viewpoint, to_viewpoint
from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.protocols.views.view import RenderView
from mirror.schema.files import write_bytes

Sky = Literal["pull", "clip", "keep"]

_CHUNK: Final = 1024
_MAX_VIEWPOINTS: Final = 32
_MIN_DISTANCE_M2: Final = 4.0
_HIDDEN_WEIGHT: Final = 0.02
_RIDGE: Final = 1e-3
_MAX_OPACITY: Final = 0.999
_CHANNELS: Final = 3


@dataclass(frozen=True, eq=False)
class ExportedGaussians:
    """Gaussians as stored in the PLY of 3D Gaussian Splatting.

    Attributes:
        means: (N, 3) float32 in the exported frame, metres.
        quats: (N, 4) unit quaternions, scalar first.
        log_scales: (N, 3) natural logarithms of metres.
        logits: (N,) logits of the opacities.
        spherical_harmonics: (N, (degree + 1)^2, 3) coefficients; a colour is their sum plus one half.
        origin_m: (3,) origin of the exported frame in the world: ``exported = world - origin_m``.
    """

    means: Tensor
    quats: Tensor
    log_scales: Tensor
    logits: Tensor
    spherical_harmonics: Tensor
    origin_m: Float64

    def __len__(self) -> int:
        return len(self.means)


def export_gaussians(
    blocks: Sequence[tuple[Block, StreetModel]],
    views: Sequence[RenderView],
    select_latents: LatentSelector,
    *,
    degree: int = 3,
    sky: Sky = "pull",
    reach_m: float = 150.0,
) -> ExportedGaussians:
    """Fit view-independent Gaussians to a street's images in the appearance of one camera on one drive.

    Opacities, scales and rotations are means over the views, taken before the networks' last activations. Colours are
    spherical harmonics, fitted by least squares with a small penalty on all but the constant, because directions from a
    road all lie near a plane. The weight of a view is the inverse square of its distance, and small where the Gaussian
    is outside the image.

    Args:
        blocks: blocks, each with its street in the block's frame.
        views: views of the camera on the drive; at most 32 of them are used, evenly spaced.
        select_latents: selects the latents that a block is exported with.
        degree: degree of the spherical harmonics, 0 to 3.
        sky: Gaussians of the sky beyond `reach_m` are pulled in to it, clipped, or kept. Viewers sort by a depth of few
            bits that covers the whole scene, so distant Gaussians make the order of near ones less exact.
        reach_m: distance from the middle of the blocks; it is enlarged to the extent of the blocks' own geometry, which
            the sky must not hide.

    Raises:
        UsageError: there is no view, the degree is out of range, or a view's lens is not a pinhole.
    """
    if not views or not 0 <= degree <= 3:
        raise UsageError(f"{len(views)} views, degree {degree}", expected="at least one view, degree 0 to 3")
    parts = split_street(blocks)
    reach_m = max(reach_m, *(_extent_m(block, parts.origin_m) for block, _ in blocks))
    chosen = [views[int(place)] for place in np.unique(np.linspace(0, len(views) - 1, _MAX_VIEWPOINTS).astype(int))]
    sky_weights = torch.stack([parts.sky_weights(view.pose.translation[0]) for view in chosen]).mean(0).tolist()
    pieces: list[_FittedGaussians] = []
    for part, weight in zip(parts.parts, sky_weights):
        latent, content = (vector.detach() for vector in select_latents(part.street.appearance))
        origin = np.array(part.block.origin_m)
        viewpoints = [to_viewpoint(view, origin) for view in chosen]
        shift = torch.from_numpy(origin - parts.origin_m).float()
        geometry = list(_export_anchors(part.street.background, part.background, viewpoints, latent, content, degree))
        geometry += list(_export_code_gaussians(part.street.ground, part.ground, viewpoints, latent, degree))
        in_sky: list[_FittedGaussians] = []
        if weight > MIN_WEIGHT:
            node = part.street.sky
            in_sky = list(_export_code_gaussians(node, torch.full((len(node),), weight), viewpoints, latent, degree))
        pieces += [piece._replace(means=piece.means + shift) for piece in geometry]
        pieces += [_apply_sky_option(piece._replace(means=piece.means + shift), sky, reach_m) for piece in in_sky]
    means, quats, log_scales, logits, coefficients = (torch.cat(columns) for columns in zip(*pieces))
    return ExportedGaussians(means, quats, log_scales, logits, coefficients, parts.origin_m)


def psnr_to_model_db(
    exported: ExportedGaussians,
    blocks: Sequence[tuple[Block, StreetModel]],
    views: Sequence[RenderView],
    select_latents: LatentSelector,
) -> float:
    """Return the PSNR of the exported street's images against the model's images, over all pixels of some views."""
    street = Composition(blocks)
    errors = []
    for view in views:
        expected = street.render(view, select_latents)[0].rgb.clamp(0.0, 1.0)
        errors.append((render_gaussians(exported, view).clamp(0.0, 1.0) - expected).square().mean())
    return float(-10.0 * torch.stack(errors).mean().clamp_min(1e-10).log10())


@torch.inference_mode()
def render_gaussians(exported: ExportedGaussians, view: RenderView) -> Tensor:
    """Render an image (H, W, 3) as a viewer of 3D Gaussian Splatting shows it."""
    viewpoint = to_viewpoint(view, exported.origin_m)
    images, _, _ = rasterization(
        exported.means,
        exported.quats,
        exported.log_scales.exp(),
        exported.logits.sigmoid(),
        exported.spherical_harmonics,
        width=viewpoint.width_px,
        height=viewpoint.height_px,
        **viewpoint.cameras_on(exported.means.device),
        near_plane=0.2,
        sh_degree=round(exported.spherical_harmonics.shape[1] ** 0.5) - 1,
    )
    return images[0]


def write_ply(path: Path, exported: ExportedGaussians) -> int:
    """Write the PLY that viewers of 3D Gaussian Splatting open.

    Opacities are logits, scales are logarithms, rotations are scalar first, and coefficients above the constant are
    stored channel by channel. A comment holds the origin of the frame in the world.

    Returns:
        Size of the file, bytes.
    """
    count, bands = exported.spherical_harmonics.shape[:2]
    names = [*"xyz", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{place}" for place in range(_CHANNELS * (bands - 1))]
    names += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    rest = exported.spherical_harmonics[:, 1:].transpose(1, 2).reshape(count, -1)
    tables = [exported.means, torch.zeros(count, 3), exported.spherical_harmonics[:, 0], rest]
    tables += [exported.logits[:, None], exported.log_scales, exported.quats]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment world origin {' '.join(map(repr, exported.origin_m.tolist()))}",
        f"element vertex {count}",
        *(f"property float {name}" for name in names),
        "end_header\n",
    ]
    data = "\n".join(header).encode() + torch.cat(tables, dim=1).numpy().astype("<f4").tobytes()
    write_bytes(path, data)
    return len(data)


class _FittedGaussians(NamedTuple):
    """Fields of `ExportedGaussians` for some Gaussians, in the frame of a block or in the exported frame."""

    means: Tensor
    quats: Tensor
    log_scales: Tensor
    logits: Tensor
    spherical_harmonics: Tensor


@torch.no_grad()
def _export_anchors(
    node: Anchors, weights: Tensor, viewpoints: Sequence[Viewpoint], latent: Tensor, content: Tensor, degree: int
) -> Iterator[_FittedGaussians]:
    reach = 3.0 * node.log_scales.amax(1).exp()
    view_weights = _view_weights(node.means, reach, viewpoints)
    for start in range(0, len(node), _CHUNK):
        span = slice(start, start + _CHUNK)
        means, sizes = node.means[span], node.log_scales[span].exp()
        rows = node.rows(torch.arange(start, start + len(means)))
        raw, colours = [], []
        for viewpoint in viewpoints:
            geometry, tints = node.read(rows, viewpoint, latent, content)
            raw.append(geometry.view(-1, GEOMETRY))
            colours.append(tints.view(-1, _CHANNELS).sigmoid())
        anchor_sizes = sizes.repeat_interleave(node.k, dim=0)
        places = means.repeat_interleave(node.k, dim=0) + node.offsets[span].reshape(-1, 3) * anchor_sizes[:, :3]
        weight = view_weights[:, span].repeat_interleave(node.k, dim=1)
        numbers = torch.stack(raw)
        opacities = numbers[..., 0].tanh().clamp_min(0.0)
        shape_weights = weight * (opacities + 1e-3)
        shape = (shape_weights[..., None] * numbers[..., 1:]).sum(0) / shape_weights.sum(0)[:, None]
        opacity = (weight * opacities).sum(0) / weight.sum(0)
        opacity = 1.0 - (1.0 - opacity.clamp_max(_MAX_OPACITY)) ** weights[span].repeat_interleave(node.k)
        yield _fit_colours(
            viewpoints,
            degree,
            means=places,
            quats=shape[:, 3:],
            scales=anchor_sizes[:, 3:] * shape[:, :3].sigmoid(),
            opacity=opacity,
            colours=torch.stack(colours),
            weights=shape_weights,
        )


@torch.no_grad()
def _export_code_gaussians(
    node: CodeGaussians, weights: Tensor, viewpoints: Sequence[Viewpoint], latent: Tensor, degree: int
) -> Iterator[_FittedGaussians]:
    view_weights = _view_weights(node.means, 3.0 * node.log_scales.amax(1).exp(), viewpoints)
    for start in range(0, len(node), _CHUNK * 8):
        span = slice(start, start + _CHUNK * 8)
        means = node.means[span]
        rows = node.rows(torch.arange(start, start + len(means)))
        colours = [node.colours(rows, viewpoint, latent) for viewpoint in viewpoints]
        opacity = 1.0 - (1.0 - node.logits[span].sigmoid().clamp_max(_MAX_OPACITY)) ** weights[span]
        scales = node.log_scales[span].exp()
        yield _fit_colours(
            viewpoints,
            degree,
            means=means,
            quats=node.quats[span],
            scales=scales,
            opacity=opacity,
            colours=torch.stack(colours),
            weights=view_weights[:, span],
        )


def _view_weights(means: Tensor, reach: Tensor, viewpoints: Sequence[Viewpoint]) -> Tensor:
    """(V, N) weight of each view for each row; the weights of a row sum to one."""
    weights = torch.full((len(viewpoints), len(means)), _HIDDEN_WEIGHT)
    for view_weights, viewpoint in zip(weights, viewpoints):
        view_weights[select_visible(viewpoint, means, reach)] = 1.0
        view_weights /= (means - viewpoint.centre).square().sum(1) + _MIN_DISTANCE_M2
    return weights / weights.sum(0)


def _fit_colours(
    viewpoints: Sequence[Viewpoint],
    degree: int,
    *,
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacity: Tensor,
    colours: Tensor,
    weights: Tensor,
) -> _FittedGaussians:
    """Fit spherical harmonics to the colours of Gaussians; transparent Gaussians are left out.

    Args:
        viewpoints: V cameras.
        degree: degree of the spherical harmonics.
        means: (N, 3) in the block's frame.
        quats: (N, 4) of any length.
        scales: (N, 3).
        opacity: (N,).
        colours: (V, N, 3) from each view.
        weights: (V, N) of each view.
    """
    kept = ((opacity >= MIN_WEIGHT) & torch.isfinite(means).all(1)).nonzero().squeeze(1)
    means, opacity = means[kept], opacity[kept].clamp_max(_MAX_OPACITY)
    bands = (degree + 1) ** 2
    # With the identity as coefficients, the sums are the basis functions.
    identity = torch.eye(bands)[None]
    basis = torch.stack([spherical_harmonics(degree, means - viewpoint.centre, identity) for viewpoint in viewpoints])
    weight = weights[:, kept].double()
    weight = weight / weight.sum(0)
    left = torch.einsum("vn,vnk,vnl->nkl", weight, basis, basis)
    right = torch.einsum("vn,vnk,vnc->nkc", weight, basis, colours[:, kept].double() - 0.5)
    penalty = torch.full((bands,), _RIDGE, dtype=torch.float64)
    penalty[0] = 1e-9
    fitted = torch.linalg.solve(left + penalty.diag(), right)
    return _FittedGaussians(
        means,
        functional.normalize(quats[kept], dim=1),
        scales[kept].clamp_min(1e-6).log(),
        opacity.logit(),
        fitted.float(),
    )


def _extent_m(block: Block, origin_m: Float64) -> float:
    """Distance from a point of the world to the farthest corner of a block's geometry, in the plan."""
    aside = np.abs(np.array(block.origin_m[:2]) - origin_m[:2]) + block.half_extent_m
    return float(np.hypot(*aside))


def _apply_sky_option(gaussians: _FittedGaussians, sky: Sky, reach_m: float) -> _FittedGaussians:
    """Pull in, clip or keep the Gaussians of the sky beyond the reach."""
    share = reach_m / gaussians.means.norm(dim=1).clamp_min(1e-9)
    if sky == "clip":
        kept = share >= 1.0
        return _FittedGaussians(*(column[kept] for column in gaussians))
    if sky == "pull":
        share = share.clamp_max(1.0)
        return gaussians._replace(
            means=gaussians.means * share[:, None], log_scales=gaussians.log_scales + share.log()[:, None]
        )
    return gaussians
