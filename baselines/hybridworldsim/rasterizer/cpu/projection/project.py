"""What one camera sees of a set of Gaussians, by compiled kernels, with gradients."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from hybridworldsim.kernels.memory import room
from hybridworldsim.kernels.threads import in_parallel
from hybridworldsim.rasterizer.cpu.projection.bending import Bending, bending_of
from hybridworldsim.rasterizer.cpu.projection.ellipses import CAUSES
from hybridworldsim.rasterizer.cpu.projection.packing import PART, InOrder
from hybridworldsim.rasterizer.cpu.projection.pinhole import project_part
from hybridworldsim.rasterizer.cpu.projection.pinhole_backward import project_part_backward
from hybridworldsim.rasterizer.cpu.projection.unscented import SCRATCH, unscented_part, unscented_part_backward
from hybridworldsim.rasterizer.cpu.projection.view import View, view_of
from hybridworldsim.rasterizer.projected import Projected

if TYPE_CHECKING:
    from hybridworldsim.rasterizer.lenses import Lens
    from hybridworldsim.rasterizer.presets import Preset

_Array = np.ndarray[Any, np.dtype[Any]]

_UPSTREAM = (torch.float32, torch.float32, torch.float64, torch.float32)
"""Of the gradients to means2d, depths, conics and compensations."""


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
) -> Projected:
    """Project Gaussians into one camera and keep those that reach its picture.

    Differentiable to means, quats, scales and viewmat. A Gaussian that cannot be projected (a quaternion that is
    no rotation, on or behind the camera plane, no invertible covariance) is culled, counted, and its gradient is 0.

    Args:
        means: (N, 3) metres, float32 or float64.
        quats: (N, 4) scalar first, of any length from 1e-30 to 1e150.
        scales: (N, 3) standard deviations, metres.
        opacities: (N,) decide how far a Gaussian reaches; no gradient.
        viewmat: (4, 4) world to camera.
        K: (3, 3) pixels; no gradient.
        width: of the picture, pixels.
        height: of the picture, pixels.
        eps2d: added to both variances in the picture, pixel^2.
        near_plane: least depth, metres.
        far_plane: greatest depth, metres.
        radius_clip: Gaussians whose radii are no larger are dropped, pixels.
        preset: gsplat's generation.
        antialiased: whether opacities shrink by the compensation.
        lens: distortion; None is a pinhole.

    Returns:
        What is seen, float32; conics and factors float64.
    """
    view = view_of(
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
    bending = None if lens is None else bending_of(lens, view)
    means2d, depths, conics, compensations, ids, low, factors, radii, counts = _Project.apply(
        means, quats, scales, viewmat, opacities, view, bending
    )
    return Projected(
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
    """A tensor's numbers as kernels take them."""
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
        view: View,
        bending: Bending | None,
    ) -> tuple[Tensor, ...]:
        dtype, number = means.dtype, len(means)
        given = tuple(flat(tensor, dtype) for tensor in (means, quats, scales, opacities))
        parts = -(-number // PART)
        outputs = InOrder(number)
        counts = np.zeros((parts, len(CAUSES)), np.int64)

        def one(part: int) -> None:
            span = part * PART, min((part + 1) * PART, number)
            with outputs.part(part) as place:
                if bending is None:
                    place.count = project_part(view, given, *span, place.rows, place.arrays, counts[part])
                else:
                    own = place.rows, np.empty(SCRATCH)
                    place.count = unscented_part(view, bending, given, *span, *own, place.arrays, counts[part])

        in_parallel(one, parts)
        ids, means2d, low, depths, conics, factors, compensations, radii = outputs.filled()
        culled = torch.from_numpy(counts.sum(axis=0))
        ctx.save_for_backward(means, quats, scales, viewmat, ids)
        ctx.view, ctx.bending = view, bending
        ctx.mark_non_differentiable(ids, low, factors, radii, culled)
        ctx.set_materialize_grads(False)
        return means2d, depths, conics, compensations, ids, low, factors, radii, culled

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        means, quats, scales, viewmat, ids = ctx.saved_tensors
        dtype, number, seen = means.dtype, len(means), len(ids)
        given = tuple(flat(tensor, dtype) for tensor in (means, quats, scales))
        upstream = tuple(
            flat(torch.zeros(3) if gradient is None else gradient, kind) for gradient, kind in zip(gradients, _UPSTREAM)
        )
        strides = tuple(0 if gradient is None else width for gradient, width in zip(gradients, (2, 1, 3, 1)))
        to_given = tuple(room(number * width, given[0].dtype).reshape(number, width) for width in (3, 4, 3))
        indices = ids.numpy()
        parts = -(-seen // PART)
        to_viewmat = np.zeros((parts, 12))

        def one(part: int) -> None:
            span = part * PART, min((part + 1) * PART, seen)
            rows, buffer = np.empty(16, np.int64), np.empty(80, given[0].dtype)
            asked, answer = (given, indices, upstream, strides, *span), (buffer, to_given, to_viewmat[part])
            if ctx.bending is None:
                project_part_backward(ctx.view, *asked, rows, *answer)
            else:
                unscented_part_backward(ctx.view, ctx.bending, *asked, rows, np.empty(SCRATCH), *answer)

        in_parallel(one, parts)
        for array in to_given:
            array[int(indices[-1]) + 1 if seen else 0 :] = 0.0
        total = np.zeros((4, 4))
        summed = to_viewmat.sum(axis=0)
        total[:3, :3], total[:3, 3] = summed[:9].reshape(3, 3), summed[9:]
        inputs = (means, quats, scales)
        to_inputs = [torch.from_numpy(array).to(tensor.dtype) for array, tensor in zip(to_given, inputs)]
        return *to_inputs, torch.from_numpy(total).to(viewmat.dtype), None, None, None
