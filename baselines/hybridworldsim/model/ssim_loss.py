"""SSIM as a loss: windows of 11 x 11 pixels, with gradients in closed form, which are cheap."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
import torch
from torch import Tensor

from hybridworldsim.kernels.dispatch import is_compiled
from hybridworldsim.model.plain.losses import structural_similarity

_REACH: Final = 5
_SIGMA: Final = 1.5
_C1: Final = 0.01**2
_C2: Final = 0.03**2
_STEPS = np.arange(-_REACH, _REACH + 1) / _SIGMA
_WINDOW = (np.exp(-0.5 * _STEPS**2) / np.exp(-0.5 * _STEPS**2).sum()).astype(np.float32)


def ssim(rendered: Tensor, recorded: Tensor) -> Tensor:
    """Compute the structural similarity (H, W), averaged over the channels.

    Pixels beyond the border are black, as in 3DGS.

    Args:
        rendered: (H, W, 3) float32; only this image gets a gradient.
        recorded: (H, W, 3) float32 in [0, 1].

    Source: Wang et al. 2004, "Image quality assessment: from error visibility to structural similarity".
    """
    if not is_compiled(rendered):
        return structural_similarity(rendered, recorded)
    return _Ssim.apply(rendered, recorded)


class _Ssim(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rendered: Tensor, recorded: Tensor) -> Tensor:
        x, y = rendered.detach(), recorded.detach()
        mean_x, mean_y, square_x, square_y, product = (_blur(image) for image in (x, y, x * x, y * y, x * y))
        luminance = 2.0 * mean_x * mean_y + _C1
        contrast = 2.0 * (product - mean_x * mean_y) + _C2
        luminance_scale = mean_x.square() + mean_y.square() + _C1
        contrast_scale = square_x + square_y - mean_x.square() - mean_y.square() + _C2
        scale = luminance_scale * contrast_scale
        ssim = luminance * contrast / scale
        if ctx.needs_input_grad[0]:
            grad_product = 2.0 * luminance / scale
            grad_square = -ssim / contrast_scale
            grad_mean = 2.0 * (
                mean_y * (contrast - luminance) / scale + mean_x * ssim * (1.0 / contrast_scale - 1.0 / luminance_scale)
            )
            ctx.save_for_backward(x, y, grad_mean, grad_square, grad_product)
        return ssim.mean(2)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        x, y, grad_mean, grad_square, grad_product = ctx.saved_tensors
        # The window is symmetric: a blur is its own adjoint.
        share = gradients[0][..., None] / 3.0
        gradient = _blur(share * grad_square).mul_(x).mul_(2.0).addcmul_(_blur(share * grad_product), y)
        return gradient.add_(_blur(share * grad_mean)), None


def _blur(image: Tensor) -> Tensor:
    """Convolve (H, W, 3) with the window."""
    blurred = cv2.sepFilter2D(image.contiguous().numpy(), cv2.CV_32F, _WINDOW, _WINDOW, borderType=cv2.BORDER_CONSTANT)
    return torch.from_numpy(blurred)
