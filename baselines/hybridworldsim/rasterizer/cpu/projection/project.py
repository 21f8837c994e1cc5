"""Projects Gaussians into a camera by compiled kernels, with gradients."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from hybridworldsim.kernels.memory import empty_aligned
from hybridworldsim.kernels.threads import in_parallel
from hybridworldsim.rasterizer.cpu.projection.ellipses import CAUSES
from hybridworldsim.rasterizer.cpu.projection.kernel_camera import to_kernel_camera
from hybridworldsim.rasterizer.cpu.projection.kernel_lens import to_kernel_lens
from hybridworldsim.rasterizer.cpu.projection.ordered_output import PART, OrderedOutput
from hybridworldsim.rasterizer.cpu.projection.pinhole import project_part
from hybridworldsim.rasterizer.cpu.projection.pinhole_backward import project_part_backward
from hybridworldsim.rasterizer.cpu.projection.rolling import KernelShutter
from hybridworldsim.rasterizer.cpu.projection.sigma_points import SCRATCH
from hybridworldsim.rasterizer.cpu.projection.unscented import unscented_part, unscented_part_backward
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians
from hybridworldsim.rasterizer.rolling_shutter import compute_motion, rotation_at

if TYPE_CHECKING:
    from hybridworldsim.rasterizer.lenses import LensDistortion
    from hybridworldsim.rasterizer.presets import GsplatPreset
    from hybridworldsim.rasterizer.rolling_shutter import ShutterMotion

_Array = np.ndarray[Any, np.dtype[Any]]

_Kernels = tuple[tuple[Callable[..., Any], Callable[..., Any]], tuple[Any, ...]]
"""The kernels of a projection, forward and backward, and the cameras that they take first."""

_UPSTREAM = (torch.float32, torch.float32, torch.float64, torch.float32)
"""Dtypes of the gradients to means2d, depths, conics and compensations."""


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
    """Project Gaussians into one camera, and keep the Gaussians that reach its image.

    Differentiable to means, quats, scales and viewmat. A Gaussian that cannot be projected is culled and counted, and
    its gradient is 0: its quaternion is no rotation, it is on or behind the camera plane, or its covariance is
    singular.

    Args:
        means: (N, 3) metres, float32 or float64.
        quats: (N, 4) scalar first, of any length from 1e-30 to 1e150.
        scales: (N, 3) standard deviations, metres.
        opacities: (N,) determine the extent of a Gaussian; no gradient.
        viewmat: (4, 4) world to camera.
        K: (3, 3) pixels; no gradient.
        width: width of the image, pixels.
        height: height of the image, pixels.
        eps2d: added to both variances in the image, pixel^2.
        near_plane: least depth, metres.
        far_plane: greatest depth, metres.
        radius_clip: Gaussians with smaller or equal radii are culled, pixels.
        preset: generation of gsplat.
        antialiased: whether opacities are multiplied by the compensation.
        lens: distortion; None for a pinhole.
        shutter: None for a global shutter; else `viewmat` is the pose at the first row, to which and to the shutter's
            end pose there are gradients, depths are those at mid-readout, and there is a lens.

    Returns:
        The visible Gaussians, float32; conics and factors are float64.
    """
    motion = None if shutter is None else compute_motion(viewmat, shutter.viewmat_end)
    view = viewmat.detach().to(torch.float64).cpu()
    middle = view if motion is None else _middle(view, motion.detach())
    camera = to_kernel_camera(
        middle.numpy(),
        K.detach().to(torch.float64).cpu().numpy(),
        width,
        height,
        eps2d=eps2d,
        near_plane=near_plane,
        far_plane=far_plane,
        radius_clip=radius_clip,
        preset=preset,
        antialiased=antialiased,
        lens=lens,
    )
    kernels: _Kernels = (project_part, project_part_backward), (camera,)
    if lens is not None:
        first, kernel_shutter = camera, None
        if shutter is not None and motion is not None:
            kernel_shutter = KernelShutter(
                shutter.per_x, shutter.per_y, shutter.offset, *view[:3, 3].tolist(), *motion.detach().tolist()
            )
            first = camera._replace(**_rotation_fields(view), t0=0.0, t1=0.0, t2=0.0)
        cameras = camera, first, to_kernel_lens(lens, camera), kernel_shutter
        kernels = (unscented_part, unscented_part_backward), cameras
    means2d, depths, conics, compensations, ids, low, factors, radii, counts = _Project.apply(
        means, quats, scales, viewmat, motion, opacities, kernels
    )
    return ProjectedGaussians(
        ids=ids,
        means2d=means2d,
        means2d_low=low,
        depths=depths,
        conics=conics,
        factors=factors,
        compensations=compensations if antialiased else None,
        radii=radii,
        counts=dict(zip(CAUSES, counts.tolist())),
    )


def flat(tensor: Tensor, dtype: torch.dtype) -> _Array:
    """Convert a tensor to a flat array of a dtype."""
    array: _Array = tensor.detach().to(dtype).contiguous().numpy().reshape(-1)
    return array


def _middle(viewmat: Tensor, motion: Tensor) -> Tensor:
    """Compute the view matrix (4, 4) at mid-readout."""
    middle = viewmat.clone()
    middle[:3, :3] = rotation_at(motion[:3], torch.tensor(0.5, dtype=torch.float64)) @ viewmat[:3, :3]
    middle[:3, 3] += 0.5 * motion[3:]
    return middle


def _rotation_fields(viewmat: Tensor) -> dict[str, Any]:
    """Return the rotation of a view matrix by the names of `KernelCamera`'s fields."""
    return {f"r{row}{column}": float(viewmat[row, column]) for row in range(3) for column in range(3)}


class _Project(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        quats: Tensor,
        scales: Tensor,
        viewmat: Tensor,
        motion: Tensor | None,
        opacities: Tensor,
        kernels: _Kernels,
    ) -> tuple[Tensor, ...]:
        dtype, number = means.dtype, len(means)
        inputs_flat = tuple(flat(tensor, dtype) for tensor in (means, quats, scales, opacities))
        parts = -(-number // PART)
        outputs = OrderedOutput(number)
        (project_kernel, _), cameras = kernels
        counts = np.zeros((parts, len(CAUSES)), np.int64)

        def run_part(part: int) -> None:
            span = part * PART, min((part + 1) * PART, number)
            with outputs.open_part(part) as output:
                scratch = () if len(cameras) == 1 else (np.empty(SCRATCH),)
                output.count = project_kernel(
                    *cameras, inputs_flat, *span, output.rows, *scratch, output.arrays, counts[part]
                )

        in_parallel(run_part, parts)
        ids, means2d, low, depths, conics, factors, compensations, radii = outputs.tensors()
        culled = torch.from_numpy(counts.sum(axis=0))
        ctx.save_for_backward(means, quats, scales, viewmat, ids)
        ctx.kernels, ctx.moves = kernels, motion is not None
        ctx.mark_non_differentiable(ids, low, factors, radii, culled)
        ctx.set_materialize_grads(False)
        return means2d, depths, conics, compensations, ids, low, factors, radii, culled

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        means, quats, scales, viewmat, ids = ctx.saved_tensors
        dtype, number, written = means.dtype, len(means), len(ids)
        inputs_flat = tuple(flat(tensor, dtype) for tensor in (means, quats, scales))
        upstream = tuple(
            flat(torch.zeros(3) if gradient is None else gradient, kind) for gradient, kind in zip(gradients, _UPSTREAM)
        )
        strides = tuple(0 if gradient is None else width for gradient, width in zip(gradients, (2, 1, 3, 1)))
        grad_inputs_flat = tuple(
            empty_aligned(number * width, inputs_flat[0].dtype).reshape(number, width) for width in (3, 4, 3)
        )
        indices = ids.numpy()
        parts = -(-written // PART)
        grad_view = np.zeros((parts, 18 if ctx.moves else 12))
        (_, backward_kernel), cameras = ctx.kernels

        def run_part(part: int) -> None:
            span = part * PART, min((part + 1) * PART, written)
            rows, buffer = np.empty(16, np.int64), np.empty(80, inputs_flat[0].dtype)
            scratch = () if len(cameras) == 1 else (np.empty(SCRATCH),)
            backward_kernel(
                *cameras, inputs_flat, indices, upstream, strides, *span, rows, *scratch, buffer, grad_inputs_flat,
                grad_view[part],
            )  # fmt: skip

        in_parallel(run_part, parts)
        for array in grad_inputs_flat:
            array[int(indices[-1]) + 1 if written else 0 :] = 0.0
        total = np.zeros((4, 4))
        summed = grad_view.sum(axis=0)
        total[:3, :3], total[:3, 3] = summed[:9].reshape(3, 3), summed[9:12]
        grad_motion = torch.from_numpy(summed[12:]) if ctx.moves else None
        inputs = (means, quats, scales)
        grad_inputs = [torch.from_numpy(array).to(tensor.dtype) for array, tensor in zip(grad_inputs_flat, inputs)]
        return *grad_inputs, torch.from_numpy(total).to(viewmat.dtype), grad_motion, None, None
