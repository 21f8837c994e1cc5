"""From checked inputs to pictures: project, colour and blend, one camera after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol

import torch
from torch import Tensor

from hybridworldsim.rasterizer.blended_image import BlendedImage
from hybridworldsim.rasterizer.inputs import Inputs, RenderMode, refuse_nonfinite
from hybridworldsim.rasterizer.lenses import Lens
from hybridworldsim.rasterizer.meta import Blending, Layout, View, make_meta
from hybridworldsim.rasterizer.presets import Preset
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians
from hybridworldsim.rasterizer.rows import copy_rows, take_rows, take_rows_with_column

_DEPTH_DIVISOR_MIN = 1e-10


class Backend(Protocol):
    """The three steps of a rasterizer, one camera at a time."""

    def project(self, *arguments: Any, **options: Any) -> ProjectedGaussians:
        """Which Gaussians a camera sees, and the ellipses that they are."""
        ...

    def spherical_harmonics(self, degree: int, directions: Tensor, coefficients: Tensor, ids: Tensor | None) -> Tensor:
        """Colours of Gaussians from where the camera is."""
        ...

    def blend(self, *arguments: Any, **options: Any) -> BlendedImage:
        """Ellipses to a picture."""
        ...


@dataclass(frozen=True, kw_only=True)
class Options:
    """How to render, as `rasterization` is told."""

    near_plane: float
    far_plane: float
    radius_clip: float
    eps2d: float
    tile_size: int
    render_mode: RenderMode
    antialiased: bool
    absgrad: bool
    preset: Preset
    backend: str


def import_backend(name: str) -> Backend:
    """The package of a backend, imported when it is needed."""
    backend: Backend = import_module(f"hybridworldsim.rasterizer.{name}")
    return backend


def render(
    inputs: Inputs, options: Options, lenses: Sequence[Lens | None], packed: bool
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Render every scene through every camera.

    Args:
        inputs: B scenes and C cameras of each.
        options: how.
        lenses: B * C of them, scene by scene.
        packed: how `meta` holds Gaussians.

    Returns:
        Pictures (..., C, height, width, channels), alphas (..., C, height, width, 1), meta.
    """
    backend = import_backend(options.backend)
    places = [(scene, camera) for scene in range(len(inputs.means)) for camera in range(inputs.cameras)]
    projected = [_project(inputs, options, backend, *place, lens) for place, lens in zip(places, lenses, strict=True)]
    layout = Layout(inputs, projected, packed)
    means2d, parts = layout.through([projection.means2d for projection in projected], options.absgrad)
    views = tuple(
        View(place, projection._replace(means2d=part), _opacities(inputs, place[0], projection))
        for place, projection, part in zip(places, projected, parts, strict=True)
    )
    blended = [
        backend.blend(
            view.projected,
            _features(inputs, options, backend, view),
            view.opacities,
            inputs.width,
            inputs.height,
            preset=options.preset,
            tile_size=options.tile_size,
            absgrad=options.absgrad,
        )
        for view in views
    ]
    alphas = _stack([projection.alpha for projection in blended])[..., None]
    images = _composite(inputs, options.render_mode, _stack([projection.image for projection in blended]), alphas)
    blending = Blending(
        views=views,
        leading=(*inputs.batch, inputs.cameras),
        width=inputs.width,
        height=inputs.height,
        tile_size=options.tile_size,
        preset=options.preset,
        backend=options.backend,
    )
    counts = [*(projection.counts for projection in projected), *(projection.counts for projection in blended)]
    meta = make_meta(layout, means2d, blending, counts)
    return blending.shaped(images), blending.shaped(alphas), meta


def _project(
    inputs: Inputs, options: Options, backend: Backend, scene: int, camera: int, lens: Lens | None
) -> ProjectedGaussians:
    tables = [inputs.means[scene], inputs.quats[scene], inputs.scales[scene], inputs.opacities[scene]]
    kept = inputs.finite(scene, camera)
    if kept is not None:
        tables = [take_rows(table, kept) for table in tables]
    projected = backend.project(
        *tables,
        inputs.viewmats[scene, camera],
        inputs.Ks[scene, camera],
        inputs.width,
        inputs.height,
        eps2d=options.eps2d,
        near_plane=options.near_plane,
        far_plane=options.far_plane,
        radius_clip=options.radius_clip,
        preset=options.preset,
        antialiased=options.antialiased,
        lens=lens,
    )
    culled = 0 if kept is None else inputs.gaussians - len(kept)
    ids = projected.ids if kept is None else kept[projected.ids]
    return projected._replace(ids=ids, counts={**projected.counts, "nonfinite": culled})


def _opacities(inputs: Inputs, scene: int, projection: ProjectedGaussians) -> Tensor:
    opacities = copy_rows(inputs.opacities[scene], projection.ids).to(projection.means2d.dtype)
    return opacities if projection.compensations is None else opacities * projection.compensations


def _features(inputs: Inputs, options: Options, backend: Backend, view: View) -> Tensor:
    projection = view.projected
    table = inputs.colors_of(*view.place)
    if table is None:
        return projection.depths[:, None]
    ids, every = projection.ids, len(projection.ids) == len(table)
    if inputs.sh_degree is not None:
        table = backend.spherical_harmonics(inputs.sh_degree, _directions(inputs, view), table, None if every else ids)
        refuse_nonfinite("colors", table, "Gaussian", ids)
        table, ids = (table + 0.5).clamp_min(0.0), torch.arange(len(ids))
    colored = options.render_mode == "RGB"
    features = take_rows(table, ids) if colored else take_rows_with_column(table, ids, projection.depths)
    if inputs.sh_degree is None:
        refuse_nonfinite("colors", features, "Gaussian", projection.ids)
    return features.to(projection.means2d.dtype)


def _directions(inputs: Inputs, view: View) -> Tensor:
    """(M, 3) from the camera to each Gaussian; exact far from the origin, as the camera's position is two float32."""
    scene, camera = view.place
    pose = inputs.viewmats[scene, camera].double()
    position = -torch.linalg.solve(pose[:3, :3], pose[:3, 3])
    means = take_rows(inputs.means[scene], view.projected.ids)
    near = position.to(means.dtype)
    return means - near - (position - near).to(means.dtype)


def _composite(inputs: Inputs, mode: RenderMode, images: Tensor, alphas: Tensor) -> Tensor:
    """Depth by the sum of weights, colours over their background.

    Args:
        inputs: whose backgrounds.
        mode: which channels there are.
        images: (B * C, height, width, channels).
        alphas: (B * C, height, width, 1).
    """
    if inputs.backgrounds is not None and "RGB" in mode:
        background = inputs.backgrounds.reshape(len(images), 1, 1, -1).to(images.dtype)
        if mode != "RGB":
            background = torch.nn.functional.pad(background, (0, 1))
        images = torch.addcmul(images, 1.0 - alphas, background)
    if mode in ("ED", "RGB+ED"):
        depth = images[..., -1:] / alphas.clamp(min=_DEPTH_DIVISOR_MIN)
        images = depth if mode == "ED" else torch.cat([images[..., :-1], depth], dim=-1)
    return images


def _stack(images: list[Tensor]) -> Tensor:
    return images[0][None] if len(images) == 1 else torch.stack(images)
