"""`rasterization`: gsplat's function, on the CPU and on CUDA."""

from __future__ import annotations

from typing import Any, Literal, get_args

import torch
from torch import Tensor

from hybridworldsim.rasterizer import cuda
from hybridworldsim.rasterizer.inputs import (
    CameraModel,
    NonFinite,
    RasterizeMode,
    RenderMode,
    check_inputs,
    make_lenses,
    require_at_least,
    require_choice,
    require_flag,
)
from hybridworldsim.rasterizer.limits import require_positive
from hybridworldsim.rasterizer.presets import DEFAULT_PRESET, get_preset
from hybridworldsim.rasterizer.rendering import RenderOptions, render
from hybridworldsim.rasterizer.shutter_inputs import make_shutters
from mirror.errors import UsageError

BackendName = Literal["auto", "cuda", "cpu", "reference"]


def rasterization(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor | None,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    packed: bool = True,
    tile_size: int = 16,
    backgrounds: Tensor | None = None,
    render_mode: RenderMode = "RGB",
    sparse_grad: bool = False,
    absgrad: bool = False,
    rasterize_mode: RasterizeMode = "classic",
    channel_chunk: int = 32,
    distributed: bool = False,
    camera_model: CameraModel = "pinhole",
    segmented: bool = False,
    covars: Tensor | None = None,
    with_ut: bool = False,
    with_eval3d: bool = False,
    radial_coeffs: Tensor | None = None,
    tangential_coeffs: Tensor | None = None,
    thin_prism_coeffs: Tensor | None = None,
    ftheta_coeffs: object = None,
    rolling_shutter: object = None,
    viewmats_rs: Tensor | None = None,
    *,
    preset: str = DEFAULT_PRESET,
    backend: BackendName = "auto",
    nonfinite: NonFinite = "raise",
) -> tuple[Tensor, Tensor, dict[str, Any]]:
    """Render 3D Gaussians as gsplat 1.5.3 does, with the same arguments in the same order, and with autograd.

    The leading dimensions "..." of all arguments are those of `means`, often none. Cameras follow OpenCV (z forward);
    pixel centres are at +0.5.

    Args:
        means: (..., N, 3) centres, metres, float32 or float64. Pass float64 means and viewmats far from the origin (up
            to 1e7 m): the camera position is subtracted in float64 before the conversion to float32.
        quats: (..., N, 4) rotations, scalar first, of any length from 1e-30 to 1e150; other lengths are degenerate.
        scales: (..., N, 3) standard deviations along the axes, metres.
        opacities: (..., N) in [0, 1].
        colors: (..., N, D) or (..., C, N, D) with any number of channels; with `sh_degree` spherical harmonics, (...,
            N, K, 3) or (..., C, N, K, 3). None if only depth is rendered.
        viewmats: (..., C, 4, 4) camera from world.
        Ks: (..., C, 3, 3) intrinsics, pixels.
        width: width of the images, pixels.
        height: height of the images, pixels.
        near_plane: metres; Gaussians with a nearer centre are culled.
        far_plane: metres; Gaussians with a farther centre are culled.
        radius_clip: pixels; Gaussians with smaller or equal radii in both directions are culled.
        eps2d: pixels^2, added to the diagonal of projected covariances.
        sh_degree: highest degree of the spherical harmonics, 0 to 4; None if colours are plain numbers.
        packed: whether tensors in `meta` list the visible Gaussians, (nnz, ...), or hold all, (..., C, N, ...).
        tile_size: side of a tile, pixels.
        backgrounds: (..., C, D) colour behind all Gaussians; the background of depth is 0.
        render_mode: "RGB": colours; "D": depth, the sum of weight times camera z; "ED": the same divided by the sum of
            weights; "RGB+D", "RGB+ED": colours with depth as the last channel.
        sparse_grad: refused: gradients on the CPU are dense.
        absgrad: whether backward also sets `meta["means2d"].absgrad`, the sum of absolute gradients over pixels.
        rasterize_mode: "antialiased" reduces opacities to compensate `eps2d`.
        channel_chunk: number of channels that gsplat's CUDA kernels render at once. The CPU renders all in one pass.
        distributed: refused.
        camera_model: "pinhole" or, with `with_ut`, "fisheye".
        segmented: choice of the sort in gsplat's CUDA code. The CPU has one sort.
        covars: refused: give `quats` and `scales`.
        with_ut: project by the unscented transform, which `fisheye`, all distortions and rolling shutters need.
        with_eval3d: refused.
        radial_coeffs: (..., C, 6), k1 to k6 of OpenCV's rational model; of a fisheye (..., C, 4).
        tangential_coeffs: (..., C, 2).
        thin_prism_coeffs: (..., C, 4).
        ftheta_coeffs: refused.
        rolling_shutter: a `RollingShutterType`, gsplat's, or its name; None is "GLOBAL". With another one, `viewmats`
            are the poses at the first row (or column), and the time of a Gaussian's points is that of their rows.
        viewmats_rs: (..., C, 4, 4) camera from world at the last row; only with a rolling shutter.
        preset: generation of gsplat whose rules and constants apply, see `presets`. On CUDA a preset is refused if the
            installed release does not follow it.
        backend: "cuda": gsplat; "cpu": compiled kernels; "reference": plain torch in float64, for small scenes; "auto":
            "cuda" for CUDA tensors, else "cpu".
        nonfinite: "raise": an error names the tensor and the first rows with NaN or infinity; "cull": these Gaussians
            are left out, without gradients; on CUDA no number is read back, and cameras are not checked. Colours are
            checked for visible Gaussians only.

    Returns:
        Images (..., C, height, width, channels), alphas (..., C, height, width, 1) and `meta`: gsplat's keys
        `batch_ids, camera_ids, gaussian_ids, radii, means2d, depths, conics, opacities, tile_width, tile_height,
        tile_size, width, height, n_batches, n_cameras`. Except on CUDA it also has `counts` of Gaussians, pairs and
        tiles, and `blending`: the Gaussians of each image as they were blended.

    Raises:
        UsageError: an argument is invalid, or is an argument of gsplat that is not supported; the error names it.
    """
    _refuse(
        sparse_grad=(sparse_grad, "dense gradients; an optimizer that skips rows can read meta['gaussian_ids']"),
        distributed=(distributed, "one process per device: render cameras in several processes"),
        covars=(covars is not None, "quats and scales"),
        with_eval3d=(with_eval3d, "with_ut=True, which evaluates Gaussians in the image"),
        ftheta_coeffs=(ftheta_coeffs is not None, "a fisheye or pinhole camera with radial_coeffs"),
    )
    require_choice("render_mode", render_mode, get_args(RenderMode))
    require_choice("rasterize_mode", rasterize_mode, get_args(RasterizeMode))
    require_choice("camera_model", camera_model, get_args(CameraModel))
    require_choice("backend", backend, get_args(BackendName))
    for name, value in {"packed": packed, "absgrad": absgrad, "with_ut": with_ut}.items():
        require_flag(name, value)
    if not far_plane >= require_at_least("near_plane", near_plane, 0.0):
        raise UsageError(
            f"the far plane at {far_plane!r} m is nearer than the near plane at {near_plane!r} m",
            place="far_plane",
            expected="at least the near plane",
        )
    chosen = choose_backend(backend, means.device) if isinstance(means, Tensor) else "cpu"
    inputs = check_inputs(
        means,
        quats,
        scales,
        opacities,
        colors,
        viewmats,
        Ks,
        width,
        height,
        sh_degree=sh_degree,
        backgrounds=backgrounds,
        render_mode=render_mode,
        nonfinite=nonfinite,
        reads_values=chosen != "cuda" or nonfinite == "raise",
    )
    coefficients = {
        "radial_coeffs": radial_coeffs,
        "tangential_coeffs": tangential_coeffs,
        "thin_prism_coeffs": thin_prism_coeffs,
    }
    antialiased = rasterize_mode == "antialiased"
    lenses = make_lenses(inputs, camera_model, with_ut, coefficients)
    shutters = make_shutters(inputs, rolling_shutter, viewmats_rs, with_ut)
    options = RenderOptions(
        near_plane=float(near_plane),
        far_plane=float(far_plane),
        radius_clip=require_at_least("radius_clip", radius_clip, 0.0),
        eps2d=require_at_least("eps2d", eps2d, 0.0),
        tile_size=require_positive("tile_size", tile_size),
        render_mode=render_mode,
        antialiased=antialiased,
        absgrad=absgrad,
        preset=get_preset(preset),
        backend=chosen,
    )
    if options.backend != "cuda":
        return render(inputs, options, lenses, shutters, packed)
    return cuda.rasterization(
        options.preset,
        nonfinite,
        means=means,
        quats=quats,
        scales=scales,
        opacities=opacities,
        colors=colors,
        viewmats=viewmats,
        Ks=Ks,
        width=width,
        height=height,
        near_plane=near_plane,
        far_plane=far_plane,
        radius_clip=radius_clip,
        eps2d=eps2d,
        sh_degree=sh_degree,
        packed=packed,
        tile_size=tile_size,
        backgrounds=backgrounds,
        render_mode=render_mode,
        absgrad=absgrad,
        rasterize_mode=rasterize_mode,
        channel_chunk=channel_chunk,
        camera_model=camera_model,
        segmented=segmented,
        with_ut=with_ut,
        rolling_shutter=rolling_shutter,
        viewmats_rs=viewmats_rs,
        **coefficients,
    )


def choose_backend(name: BackendName, device: torch.device) -> str:
    """Choose a backend by its name, or for ``auto`` by the device.

    Raises:
        UsageError: the backend does not support the device of the tensors.
    """
    chosen = ("cuda" if device.type == "cuda" else "cpu") if name == "auto" else name
    if (chosen == "cuda") != (device.type == "cuda"):
        where = "cuda" if chosen == "cuda" else "cpu"
        raise UsageError(f"tensors are on {device}", place=f"backend={name!r}", remedy=f'move them: .to("{where}")')
    return chosen


def _refuse(**unsupported: tuple[bool, str]) -> None:
    """Refuse unsupported arguments; each has a flag whether it is used, and an alternative."""
    for name, (is_used, instead) in unsupported.items():
        if is_used:
            raise UsageError("gsplat has this, hybridworldsim does not", place=name, expected=instead)
