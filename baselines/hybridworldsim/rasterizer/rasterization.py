"""`rasterization`: gsplat's function, on the CPU as on CUDA."""

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
from hybridworldsim.rasterizer.rendering import Options, render
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
    """Render 3D Gaussians as gsplat 1.5.3 does: same arguments, same order, same meaning, and autograd to all of them.

    Leading dimensions "..." are those of `means`, often none. Cameras are OpenCV's (z forward), pixel centres at +0.5.

    Args:
        means: (..., N, 3) centres, metres. Float32 or float64: centres and cameras far from the origin, up to 1e7 m,
            want float64, in which the camera's position is subtracted before anything is float32.
        quats: (..., N, 4) rotations, scalar first, of any length from 1e-30 to 1e150; others are degenerate.
        scales: (..., N, 3) standard deviations along the axes, metres.
        opacities: (..., N) in [0, 1].
        colors: (..., N, D) or (..., C, N, D) of any number of channels; with `sh_degree` spherical harmonics, (..., N,
            K, 3) or (..., C, N, K, 3). None if only depth is asked for.
        viewmats: (..., C, 4, 4) camera from world.
        Ks: (..., C, 3, 3) intrinsics, pixels.
        width: pixels.
        height: pixels.
        near_plane: metres; Gaussians whose centre is nearer are culled.
        far_plane: metres; Gaussians whose centre is farther are culled.
        radius_clip: pixels; Gaussians that reach no farther in both directions are culled.
        eps2d: pixels^2 added to the diagonal of projected covariances.
        sh_degree: up to which bands are used, 0 to 4; None if colours are plain numbers.
        packed: whether `meta` lists what each camera sees, (nnz, ...), or holds all, (..., C, N, ...).
        tile_size: pixels.
        backgrounds: (..., C, D) colour behind everything; that of depth is 0.
        render_mode: "RGB" colours; "D" depth, sum of weight times camera z; "ED" the same by the sum of weights;
            or colours with depth as the last channel.
        sparse_grad: refused: on the CPU gradients are dense.
        absgrad: whether backward also sets `meta["means2d"].absgrad`, summed over pixels without their signs.
        rasterize_mode: "antialiased" shrinks opacities by what `eps2d` widened.
        channel_chunk: how many channels gsplat's CUDA kernels render at once. The CPU renders all in one pass.
        distributed: refused.
        camera_model: "pinhole" or, with `with_ut`, "fisheye".
        segmented: which of its sorts gsplat's CUDA code takes. The CPU has one.
        covars: refused: give `quats` and `scales`.
        with_ut: project by the unscented transform: for `fisheye` and all distortions; "classic" only.
        with_eval3d: refused.
        radial_coeffs: (..., C, 6), k1 to k6 of OpenCV's rational model; of a fisheye (..., C, 4).
        tangential_coeffs: (..., C, 2).
        thin_prism_coeffs: (..., C, 4).
        ftheta_coeffs: refused.
        rolling_shutter: refused, but for None and gsplat's own GLOBAL.
        viewmats_rs: refused.
        preset: which generation of gsplat is followed to the constant, see `presets`. On CUDA, gsplat does what it
            does: a preset that is not of the installed release is refused.
        backend: "cuda" calls gsplat; "cpu" is compiled; "reference" is plain torch in float64, for small scenes.
            "auto" is "cuda" for tensors there, else "cpu".
        nonfinite: "raise" names the tensor and first rows that hold NaN or infinity; "cull" leaves these Gaussians
            out, without gradients. Colours are looked at where they are drawn.

    Returns:
        Pictures (..., C, height, width, channels), alphas (..., C, height, width, 1) and `meta`: gsplat's keys
        `batch_ids, camera_ids, gaussian_ids, radii, means2d, depths, conics, opacities, tile_width, tile_height,
        tile_size, width, height, n_batches, n_cameras`; and, unless on CUDA, the `counts` of work done and left out
        and `blending`: the Gaussians of each image as they were blended.

    Raises:
        UsageError: an argument cannot mean anything, or is one of gsplat's that is not done here; it is named.
    """
    _refuse(
        sparse_grad=(sparse_grad, "dense gradients; an optimizer that skips rows can read meta['gaussian_ids']"),
        distributed=(distributed, "one process a device; render cameras in several"),
        covars=(covars is not None, "quats and scales"),
        with_eval3d=(with_eval3d, "with_ut=True, which evaluates Gaussians in the picture"),
        ftheta_coeffs=(ftheta_coeffs is not None, "a fisheye or pinhole camera with radial_coeffs"),
        rolling_shutter=(getattr(rolling_shutter, "name", rolling_shutter) not in (None, "GLOBAL"), "a global shutter"),
        viewmats_rs=(viewmats_rs is not None, "a global shutter"),
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
    )
    coefficients = {
        "radial_coeffs": radial_coeffs,
        "tangential_coeffs": tangential_coeffs,
        "thin_prism_coeffs": thin_prism_coeffs,
    }
    antialiased = rasterize_mode == "antialiased"
    lenses = make_lenses(inputs, camera_model, with_ut, antialiased, coefficients)
    options = Options(
        near_plane=float(near_plane),
        far_plane=float(far_plane),
        radius_clip=require_at_least("radius_clip", radius_clip, 0.0),
        eps2d=require_at_least("eps2d", eps2d, 0.0),
        tile_size=require_positive("tile_size", tile_size),
        render_mode=render_mode,
        antialiased=antialiased,
        absgrad=absgrad,
        preset=get_preset(preset),
        backend=choose_backend(backend, means.device),
    )
    if options.backend != "cuda":
        return render(inputs, options, lenses, packed)
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
        **coefficients,
    )


def choose_backend(name: BackendName, device: torch.device) -> str:
    """The backend that a name stands for.

    Raises:
        UsageError: it does not work where the tensors are.
    """
    chosen = ("cuda" if device.type == "cuda" else "cpu") if name == "auto" else name
    if (chosen == "cuda") != (device.type == "cuda"):
        where = "cuda" if chosen == "cuda" else "cpu"
        raise UsageError(f"tensors are on {device}", place=f"backend={name!r}", remedy=f'move them: .to("{where}")')
    return chosen


def _refuse(**unsupported: tuple[bool, str]) -> None:
    for name, (asked, instead) in unsupported.items():
        if asked:
            raise UsageError("gsplat has this, hybridworldsim does not", place=name, expected=instead)
