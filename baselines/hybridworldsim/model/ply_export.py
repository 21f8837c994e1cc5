"""A street as vanilla 3D Gaussian Splatting, for viewers that know nothing of codes: one drive, one camera."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from hybridworldsim.model.blocks import Block
from hybridworldsim.model.composition import Composition
from hybridworldsim.model.nodes.anchors import Anchors
from hybridworldsim.model.nodes.code_gaussians import CodeGaussians
from hybridworldsim.model.nodes.gaussian_assembly import GEOMETRY
from hybridworldsim.model.parts import LEAST, LatentSelector, split_street
from hybridworldsim.model.street import Street
from hybridworldsim.model.visible import select_visible
from hybridworldsim.rasterizer import rasterization
from hybridworldsim.rasterizer.reference.spherical_harmonics import spherical_harmonics
from hybridworldsim.training.viewpoint import Viewpoint, to_viewpoint
from mirror.arrays import Float64
from mirror.errors import UsageError
from mirror.protocols.views.view import RenderView
from mirror.schema.files import write_bytes

Sky = Literal["pull", "clip", "keep"]

_CHUNK: Final = 1024
_MOST_EYES: Final = 32
_NEAR_M2: Final = 4.0
_UNSEEN: Final = 0.02
_RIDGE: Final = 1e-3
_MOST: Final = 0.999
_CHANNELS: Final = 3


@dataclass(frozen=True, eq=False)
class ExportedGaussians:
    """Gaussians as the PLY of 3D Gaussian Splatting has them.

    Attributes:
        means: (N, 3) float32 in the baked frame, metres.
        quats: (N, 4) unit, scalar first.
        log_scales: (N, 3) natural logarithm of metres.
        logits: (N,) of opacity.
        harmonics: (N, (degree + 1)^2, 3); a colour is their sum plus a half.
        origin_m: (3,) of the baked frame in the world: ``baked = world - origin_m``.
    """

    means: Tensor
    quats: Tensor
    log_scales: Tensor
    logits: Tensor
    harmonics: Tensor
    origin_m: Float64

    def __len__(self) -> int:
        return len(self.means)


def bake(
    blocks: Sequence[tuple[Block, Street]],
    views: Sequence[RenderView],
    looks: LatentSelector,
    *,
    degree: int = 3,
    sky: Sky = "pull",
    reach_m: float = 150.0,
) -> ExportedGaussians:
    """Fit Gaussians that do not change with the view to what a street shows one camera on one drive.

    Opacities, scales and rotations are means over the views, taken before the networks' last functions; colours
    are harmonics, by least squares with a small penalty on all but the constant, since directions from a road all lie
    near a plane. Views weigh by the inverse square of the distance, and little where the Gaussian is not in the
    image.

    Args:
        blocks: with the street of each.
        views: of the camera on the drive; at most 32 of them are taken, evenly.
        looks: the appearance.
        degree: of the harmonics, 0 to 3.
        sky: what lies beyond a reach is pulled in to it, left out, or kept. Viewers sort by a depth of few bits, spread
            over all that there is: what is very far costs order near by.
        reach_m: how far from the middle of the blocks; farther where a block's own geometry is, which it must not hide.

    Raises:
        UsageError: there is no view, no such degree, or a view is not of a pinhole camera.
    """
    if not views or not 0 <= degree <= 3:
        raise UsageError(f"{len(views)} views, degree {degree}", expected="at least one view, degree 0 to 3")
    every = split_street(blocks)
    reach_m = max(reach_m, *(_end_m(block, every.origin_m) for block, _ in blocks))
    chosen = [views[int(place)] for place in np.unique(np.linspace(0, len(views) - 1, _MOST_EYES).astype(int))]
    sky_weights = torch.stack([every.sky_weights(view.pose.translation[0]) for view in chosen]).mean(0).tolist()
    pieces: list[tuple[Tensor, ...]] = []
    for part, weight in zip(every.parts, sky_weights):
        latent, content = (vector.detach() for vector in looks(part.street.appearance))
        origin = np.array(part.block.origin_m)
        eyes = [to_viewpoint(view, origin) for view in chosen]
        shift = torch.from_numpy(origin - every.origin_m).float()
        near = list(_background(part.street.background, part.background, eyes, latent, content, degree))
        near += list(_coded(part.street.ground, part.ground, eyes, latent, degree))
        far = []
        if weight > LEAST:
            node = part.street.sky
            far = list(_coded(node, torch.full((len(node),), weight), eyes, latent, degree))
        pieces += [(means + shift, *rest) for means, *rest in near]
        pieces += [_brought(means + shift, rest, sky, reach_m) for means, *rest in far]
    means, quats, log_scales, logits, colours = (torch.cat(columns) for columns in zip(*pieces))
    return ExportedGaussians(means, quats, log_scales, logits, colours, every.origin_m)


def psnr_to_model_db(
    baked: ExportedGaussians, blocks: Sequence[tuple[Block, Street]], views: Sequence[RenderView], looks: LatentSelector
) -> float:
    """What baking loses: PSNR of the baked street's images against the model's, over all pixels of some views."""
    street = Composition(blocks)
    errors = []
    for view in views:
        expected = street.render(view, looks)[0].rgb.clamp(0.0, 1.0)
        errors.append((render_gaussians(baked, view).clamp(0.0, 1.0) - expected).square().mean())
    return float(-10.0 * torch.stack(errors).mean().clamp_min(1e-10).log10())


@torch.inference_mode()
def render_gaussians(baked: ExportedGaussians, view: RenderView) -> Tensor:
    """(H, W, 3) as a viewer shows it."""
    viewpoint = to_viewpoint(view, baked.origin_m)
    images, _, _ = rasterization(
        baked.means,
        baked.quats,
        baked.log_scales.exp(),
        baked.logits.sigmoid(),
        baked.harmonics,
        viewpoint.viewmat[None],
        viewpoint.K[None],
        viewpoint.width_px,
        viewpoint.height_px,
        near_plane=0.2,
        sh_degree=round(baked.harmonics.shape[1] ** 0.5) - 1,
    )
    return images[0]


def write_ply(path: Path, baked: ExportedGaussians) -> int:
    """Write the PLY that viewers of 3D Gaussian Splatting open.

    Opacities are logits, scales logarithms, rotations scalar first, harmonics above the constant channel by channel.
    A comment says where the frame's origin is in the world.

    Returns:
        Bytes of the file.
    """
    count, bands = baked.harmonics.shape[:2]
    names = [*"xyz", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    names += [f"f_rest_{place}" for place in range(_CHANNELS * (bands - 1))]
    names += ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]
    rest = baked.harmonics[:, 1:].transpose(1, 2).reshape(count, -1)
    tables = [baked.means, torch.zeros(count, 3), baked.harmonics[:, 0], rest]
    tables += [baked.logits[:, None], baked.log_scales, baked.quats]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment world origin {' '.join(map(repr, baked.origin_m.tolist()))}",
        f"element vertex {count}",
        *(f"property float {name}" for name in names),
        "end_header\n",
    ]
    data = "\n".join(header).encode() + torch.cat(tables, dim=1).numpy().astype("<f4").tobytes()
    write_bytes(path, data)
    return len(data)


@torch.no_grad()
def _background(
    node: Anchors, weights: Tensor, eyes: Sequence[Viewpoint], latent: Tensor, content: Tensor, degree: int
) -> Iterator[tuple[Tensor, ...]]:
    reach = 3.0 * node.log_scales.amax(1).exp()
    seeing = _seeing(node.means, reach, eyes)
    for start in range(0, len(node), _CHUNK):
        span = slice(start, start + _CHUNK)
        means, sizes = node.means[span], node.log_scales[span].exp()
        rows = node.rows(torch.arange(start, start + len(means)))
        raw, colours = [], []
        for eye in eyes:
            geometry, tints = node.read(rows, eye, latent, content)
            raw.append(geometry.view(-1, GEOMETRY))
            colours.append(tints.view(-1, _CHANNELS).sigmoid())
        own = sizes.repeat_interleave(node.k, dim=0)
        places = means.repeat_interleave(node.k, dim=0) + node.offsets[span].reshape(-1, 3) * own[:, :3]
        weight = seeing[:, span].repeat_interleave(node.k, dim=1)
        numbers = torch.stack(raw)
        opacities = numbers[..., 0].tanh().clamp_min(0.0)
        shown = weight * (opacities + 1e-3)
        shape = (shown[..., None] * numbers[..., 1:]).sum(0) / shown.sum(0)[:, None]
        opacity = (weight * opacities).sum(0) / weight.sum(0)
        opacity = 1.0 - (1.0 - opacity.clamp_max(_MOST)) ** weights[span].repeat_interleave(node.k)
        yield _fitted(
            places,
            shape[:, 3:],
            own[:, 3:] * shape[:, :3].sigmoid(),
            opacity,
            torch.stack(colours),
            shown,
            eyes,
            degree,
        )


@torch.no_grad()
def _coded(
    node: CodeGaussians, weights: Tensor, eyes: Sequence[Viewpoint], latent: Tensor, degree: int
) -> Iterator[tuple[Tensor, ...]]:
    seeing = _seeing(node.means, 3.0 * node.log_scales.amax(1).exp(), eyes)
    for start in range(0, len(node), _CHUNK * 8):
        span = slice(start, start + _CHUNK * 8)
        means = node.means[span]
        rows = node.rows(torch.arange(start, start + len(means)))
        colours = [node.colours(rows, eye, latent) for eye in eyes]
        opacity = 1.0 - (1.0 - node.logits[span].sigmoid().clamp_max(_MOST)) ** weights[span]
        scales = node.log_scales[span].exp()
        yield _fitted(means, node.quats[span], scales, opacity, torch.stack(colours), seeing[:, span], eyes, degree)


def _seeing(means: Tensor, reach: Tensor, eyes: Sequence[Viewpoint]) -> Tensor:
    """(V, N) how much each view counts for each row."""
    weights = torch.full((len(eyes), len(means)), _UNSEEN)
    for own, eye in zip(weights, eyes):
        own[select_visible(eye, means, reach)] = 1.0
        own /= (means - eye.centre).square().sum(1) + _NEAR_M2
    return weights / weights.sum(0)


def _fitted(
    places: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacity: Tensor,
    colours: Tensor,
    weights: Tensor,
    eyes: Sequence[Viewpoint],
    degree: int,
) -> tuple[Tensor, ...]:
    """Those that can be seen at all: centres, rotations, logarithms of scales, logits, harmonics.

    Args:
        places: (N, 3) in the block's frame.
        quats: (N, 4) of any length.
        scales: (N, 3).
        opacity: (N,).
        colours: (V, N, 3) from each view.
        weights: (V, N).
        eyes: V.
        degree: of the harmonics.
    """
    kept = ((opacity >= LEAST) & torch.isfinite(places).all(1)).nonzero().squeeze(1)
    places, opacity = places[kept], opacity[kept].clamp_max(_MOST)
    bands = (degree + 1) ** 2
    identity = torch.eye(bands)[None]  # its sums are the harmonics themselves
    basis = torch.stack([spherical_harmonics(degree, places - eye.centre, identity) for eye in eyes])
    weight = weights[:, kept].double()
    weight = weight / weight.sum(0)
    left = torch.einsum("vn,vnk,vnl->nkl", weight, basis, basis)
    right = torch.einsum("vn,vnk,vnc->nkc", weight, basis, colours[:, kept].double() - 0.5)
    penalty = torch.full((bands,), _RIDGE, dtype=torch.float64)
    penalty[0] = 1e-9
    fitted = torch.linalg.solve(left + penalty.diag(), right)
    return (
        places,
        functional.normalize(quats[kept], dim=1),
        scales[kept].clamp_min(1e-6).log(),
        opacity.logit(),
        fitted.float(),
    )


def _end_m(block: Block, origin_m: Float64) -> float:
    """How far from a place of the world a block's geometry goes."""
    aside = np.abs(np.array(block.origin_m[:2]) - origin_m[:2]) + block.half_extent_m
    return float(np.hypot(*aside))


def _brought(means: Tensor, rest: Sequence[Tensor], sky: Sky, reach_m: float) -> tuple[Tensor, ...]:
    """The sky's Gaussians, with those beyond the reach as they shall be."""
    quats, log_scales, logits, colours = rest
    share = reach_m / means.norm(dim=1).clamp_min(1e-9)
    if sky == "clip":
        kept = share >= 1.0
        return means[kept], quats[kept], log_scales[kept], logits[kept], colours[kept]
    if sky == "pull":
        share = share.clamp_max(1.0)
        means, log_scales = means * share[:, None], log_scales + share.log()[:, None]
    return means, quats, log_scales, logits, colours
