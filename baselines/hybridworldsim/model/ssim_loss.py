"""SSIM as a loss: windows of 11 x 11, gradients in closed form, so that a step pays little for them."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
import torch
from torch import Tensor

_REACH: Final = 5
_SIGMA: Final = 1.5
_C1: Final = 0.01**2
_C2: Final = 0.03**2
_STEPS = np.arange(-_REACH, _REACH + 1) / _SIGMA
_WINDOW = (np.exp(-0.5 * _STEPS**2) / np.exp(-0.5 * _STEPS**2).sum()).astype(np.float32)


def ssim(rendered: Tensor, taken: Tensor) -> Tensor:
    """(H, W) structural similarity, mean of the channels; beyond the border there is black, as in 3DGS.

    Args:
        rendered: (H, W, 3) float32; gradients flow to it alone.
        taken: (H, W, 3) float32 in [0, 1].

    Source: Wang et al. 2004, "Image quality assessment: from error visibility to structural similarity".
    """
    return _Ssim.apply(rendered, taken)


class _Ssim(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rendered: Tensor, taken: Tensor) -> Tensor:
        x, y = rendered.detach(), taken.detach()
        mean_x, mean_y, square_x, square_y, product = (_blurred(one) for one in (x, y, x * x, y * y, x * y))
        light = 2.0 * mean_x * mean_y + _C1
        texture = 2.0 * (product - mean_x * mean_y) + _C2
        light_most = mean_x.square() + mean_y.square() + _C1
        texture_most = square_x + square_y - mean_x.square() - mean_y.square() + _C2
        most = light_most * texture_most
        ssim = light * texture / most
        if ctx.needs_input_grad[0]:
            by_product = 2.0 * light / most
            by_square = -ssim / texture_most
            by_mean = 2.0 * (
                mean_y * (texture - light) / most + mean_x * ssim * (1.0 / texture_most - 1.0 / light_most)
            )
            ctx.save_for_backward(x, y, by_mean, by_square, by_product)
        return ssim.mean(2)

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None]:
        x, y, by_mean, by_square, by_product = ctx.saved_tensors
        # The window is symmetric: a blur is its own adjoint.
        share = gradients[0][..., None] / 3.0
        through = _blurred(share * by_square).mul_(x).mul_(2.0).addcmul_(_blurred(share * by_product), y)
        return through.add_(_blurred(share * by_mean)), None


def _blurred(image: Tensor) -> Tensor:
    """(H, W, 3) convolved with the window."""
    blurred = cv2.sepFilter2D(image.contiguous().numpy(), cv2.CV_32F, _WINDOW, _WINDOW, borderType=cv2.BORDER_CONSTANT)
    return torch.from_numpy(blurred)
