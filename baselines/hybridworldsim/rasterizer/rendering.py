"""Renders checked inputs: projects, colours and blends Gaussians, one camera after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Protocol

import torch
from torch import Tensor

from hybridworldsim.rasterizer.blended_image import BlendedImage
from hybridworldsim.rasterizer.inputs import Inputs, RenderMode, refuse_nonfinite
from hybridworldsim.rasterizer.lenses import LensDistortion
from hybridworldsim.rasterizer.meta import BlendedView, Blending, GaussianLayout, make_meta
from hybridworldsim.rasterizer.presets import GsplatPreset
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians
from hybridworldsim.rasterizer.rolling_shutter import ShutterMotion
from hybridworldsim.rasterizer.rows import copy_rows, take_rows, take_rows_with_column

_DEPTH_DIVISOR_MIN = 1e-10


class Backend(Protocol):
    """The three steps of a rasterizer for one camera."""

    def project(self, *arguments: Any, **options: Any) -> ProjectedGaussians:
        """Project Gaussians to the ellipses that reach the image."""
        ...

    def spherical_harmonics(self, degree: int, directions: Tensor, coefficients: Tensor, ids: Tensor | None) -> Tensor:
        """Compute the colours of Gaussians in the direction of the camera."""
        ...

    def blend(self, *arguments: Any, **options: Any) -> BlendedImage:
        """Blend ellipses to an image."""
        ...


@dataclass(frozen=True, kw_only=True)
class RenderOptions:
    """The options of `rasterization`."""

    near_plane: float
    far_plane: float
    radius_clip: float
    eps2d: float
    tile_size: int
    render_mode: RenderMode
    antialiased: bool
    absgrad: bool
    preset: GsplatPreset
    backend: str


def import_backend(name: str) -> Backend:
    """Import the package of a backend."""
    backend: Backend = import_module(f"hybridworldsim.rasterizer.{name}")
    return backend


def render(
    inputs: Inputs,
    options: RenderOptions,
    lenses: Sequence[LensDistortion | None],
    shutters: Sequence[ShutterMotion | None],
    packed: bool,
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Render each scene through each of its cameras.

    Args:
        inputs: B scenes with C cameras each.
        options: the options.
        lenses: B * C lenses, scene by scene.
        shutters: B * C shutters, likewise.
        packed: whether tensors in `meta` are packed.

    Returns:
        Images (..., C, height, width, channels), alphas (..., C, height, width, 1), meta.
    """
    backend = import_backend(options.backend)
    scene_cameras = [(scene, camera) for scene in range(len(inputs.means)) for camera in range(inputs.cameras)]
    projected = [
        _project(inputs, options, backend, *scene_camera, lens, shutter)
        for scene_camera, lens, shutter in zip(scene_cameras, lenses, shutters, strict=True)
    ]
    layout = GaussianLayout(inputs, projected, packed)
    means2d, parts = layout.link_means2d([projection.means2d for projection in projected], options.absgrad)
    views = tuple(
        BlendedView(
            scene_camera, projection._replace(means2d=part), _compute_opacities(inputs, scene_camera[0], projection)
        )
        for scene_camera, projection, part in zip(scene_cameras, projected, parts, strict=True)
    )
    blended = [
        backend.blend(
            view.projected,
            _gather_features(inputs, options, backend, view, shutter),
            view.opacities,
            inputs.width,
            inputs.height,
            preset=options.preset,
            tile_size=options.tile_size,
            absgrad=options.absgrad,
        )
        for view, shutter in zip(views, shutters, strict=True)
    ]
    alphas = _stack([image.alpha for image in blended])[..., None]
    images = _composite(inputs, options.render_mode, _stack([image.image for image in blended]), alphas)
    blending = Blending(
        views=views,
        leading=(*inputs.batch, inputs.cameras),
        width=inputs.width,
        height=inputs.height,
        tile_size=options.tile_size,
        preset=options.preset,
        backend=options.backend,
    )
    counts = [*(projection.counts for projection in projected), *(image.counts for image in blended)]
    meta = make_meta(layout, means2d, blending, counts)
    return blending.to_batch_shape(images), blending.to_batch_shape(alphas), meta


def _project(
    inputs: Inputs,
    options: RenderOptions,
    backend: Backend,
    scene: int,
    camera: int,
    lens: LensDistortion | None,
    shutter: ShutterMotion | None,
) -> ProjectedGaussians:
    """Project the Gaussians of a scene, without those that are culled because they are not finite."""
    tables = [inputs.means[scene], inputs.quats[scene], inputs.scales[scene], inputs.opacities[scene]]
    kept = inputs.find_finite(scene, camera)
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
        shutter=shutter,
    )
    culled = 0 if kept is None else inputs.gaussians - len(kept)
    ids = projected.ids if kept is None else kept[projected.ids]
    return projected._replace(ids=ids, counts={**projected.counts, "nonfinite": culled})


def _compute_opacities(inputs: Inputs, scene: int, projection: ProjectedGaussians) -> Tensor:
    """Copy the opacities (M,) of visible Gaussians, compensated if antialiased."""
    opacities = copy_rows(inputs.opacities[scene], projection.ids).to(projection.means2d.dtype)
    return opacities if projection.compensations is None else opacities * projection.compensations


def _gather_features(
    inputs: Inputs, options: RenderOptions, backend: Backend, view: BlendedView, shutter: ShutterMotion | None
) -> Tensor:
    """Gather the channels (M, D) that are blended: colours, depth or both."""
    projection = view.projected
    table = inputs.get_colors(*view.scene_camera)
    if table is None:
        return projection.depths[:, None]
    ids, has_all = projection.ids, len(projection.ids) == len(table)
    if inputs.sh_degree is not None:
        table = backend.spherical_harmonics(
            inputs.sh_degree, _compute_directions(inputs, view, shutter), table, None if has_all else ids
        )
        refuse_nonfinite("colors", table, "Gaussian", ids)
        table, ids = (table + 0.5).clamp_min(0.0), torch.arange(len(ids))
    colored = options.render_mode == "RGB"
    features = take_rows(table, ids) if colored else take_rows_with_column(table, ids, projection.depths)
    if inputs.sh_degree is None:
        refuse_nonfinite("colors", features, "Gaussian", projection.ids)
    return features.to(projection.means2d.dtype)


def _compute_directions(inputs: Inputs, view: BlendedView, shutter: ShutterMotion | None) -> Tensor:
    """Compute directions (M, 3) from the camera to each Gaussian; they are exact far from the origin.

    The camera position is a sum of two numbers of the means' dtype. With a rolling shutter it is the middle of the two
    end positions, as in gsplat.
    """
    scene, camera = view.scene_camera
    position = _compute_position(inputs.viewmats[scene, camera])
    if shutter is not None:
        position = 0.5 * (position + _compute_position(shutter.viewmat_end))
    means = take_rows(inputs.means[scene], view.projected.ids)
    rounded = position.to(means.dtype)
    return means - rounded - (position - rounded).to(means.dtype)


def _compute_position(viewmat: Tensor) -> Tensor:
    """Compute the position (3,) of a camera in float64."""
    pose = viewmat.double()
    return -torch.linalg.solve(pose[:3, :3], pose[:3, 3])


def _composite(inputs: Inputs, mode: RenderMode, images: Tensor, alphas: Tensor) -> Tensor:
    """Divide depth by the sum of weights, and add backgrounds to colours.

    Args:
        inputs: the inputs with the backgrounds.
        mode: the channels.
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
