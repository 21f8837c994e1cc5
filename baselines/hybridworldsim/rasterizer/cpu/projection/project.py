"""Projects Gaussians into a camera by compiled kernels, with gradients."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from hybridworldsim.kernels.memory import empty_aligned
from hybridworldsim.kernels.threads import in_parallel
from hybridworldsim.rasterizer.cpu.projection.ellipses import CAUSES
from hybridworldsim.rasterizer.cpu.projection.kernel_camera import KernelCamera, to_kernel_camera
from hybridworldsim.rasterizer.cpu.projection.kernel_lens import KernelLens, to_kernel_lens
from hybridworldsim.rasterizer.cpu.projection.ordered_output import PART, OrderedOutput
from hybridworldsim.rasterizer.cpu.projection.pinhole import project_part
from hybridworldsim.rasterizer.cpu.projection.pinhole_backward import project_part_backward
from hybridworldsim.rasterizer.cpu.projection.unscented import SCRATCH, unscented_part, unscented_part_backward
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians

if TYPE_CHECKING:
    from hybridworldsim.rasterizer.lenses import LensDistortion
    from hybridworldsim.rasterizer.presets import GsplatPreset

_Array = np.ndarray[Any, np.dtype[Any]]

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

    Returns:
        The visible Gaussians, float32; conics and factors are float64.
    """
    camera = to_kernel_camera(
        viewmat.detach().to(torch.float64).cpu().numpy(),
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
    kernel_lens = None if lens is None else to_kernel_lens(lens, camera)
    means2d, depths, conics, compensations, ids, low, factors, radii, counts = _Project.apply(
        means, quats, scales, viewmat, opacities, camera, kernel_lens
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


class _Project(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        means: Tensor,
        quats: Tensor,
        scales: Tensor,
        viewmat: Tensor,
        opacities: Tensor,
        camera: KernelCamera,
        kernel_lens: KernelLens | None,
    ) -> tuple[Tensor, ...]:
        dtype, number = means.dtype, len(means)
        inputs_flat = tuple(flat(tensor, dtype) for tensor in (means, quats, scales, opacities))
        parts = -(-number // PART)
        outputs = OrderedOutput(number)
        counts = np.zeros((parts, len(CAUSES)), np.int64)

        def run_part(part: int) -> None:
            span = part * PART, min((part + 1) * PART, number)
            with outputs.open_part(part) as output:
                if kernel_lens is None:
                    output.count = project_part(camera, inputs_flat, *span, output.rows, output.arrays, counts[part])
                else:
                    scratch = output.rows, np.empty(SCRATCH)
                    output.count = unscented_part(
                        camera, kernel_lens, inputs_flat, *span, *scratch, output.arrays, counts[part]
                    )

        in_parallel(run_part, parts)
        ids, means2d, low, depths, conics, factors, compensations, radii = outputs.tensors()
        culled = torch.from_numpy(counts.sum(axis=0))
        ctx.save_for_backward(means, quats, scales, viewmat, ids)
        ctx.camera, ctx.kernel_lens = camera, kernel_lens
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
        grad_viewmat = np.zeros((parts, 12))

        def run_part(part: int) -> None:
            span = part * PART, min((part + 1) * PART, written)
            rows, buffer = np.empty(16, np.int64), np.empty(80, inputs_flat[0].dtype)
            arguments, outputs = (
                (inputs_flat, indices, upstream, strides, *span),
                (buffer, grad_inputs_flat, grad_viewmat[part]),
            )
            if ctx.kernel_lens is None:
                project_part_backward(ctx.camera, *arguments, rows, *outputs)
            else:
                unscented_part_backward(ctx.camera, ctx.kernel_lens, *arguments, rows, np.empty(SCRATCH), *outputs)

        in_parallel(run_part, parts)
        for array in grad_inputs_flat:
            array[int(indices[-1]) + 1 if written else 0 :] = 0.0
        total = np.zeros((4, 4))
        summed = grad_viewmat.sum(axis=0)
        total[:3, :3], total[:3, 3] = summed[:9].reshape(3, 3), summed[9:]
        inputs = (means, quats, scales)
        grad_inputs = [torch.from_numpy(array).to(tensor.dtype) for array, tensor in zip(grad_inputs_flat, inputs)]
        return *grad_inputs, torch.from_numpy(total).to(viewmat.dtype), None, None, None
