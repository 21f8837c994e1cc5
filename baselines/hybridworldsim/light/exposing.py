"""The compiled form of a camera's response, with gradients: one pass over the image each way."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.memory import empty_aligned
from hybridworldsim.kernels.threads import in_row_spans
from hybridworldsim.light.tone_curve import DARKEST
from mirror.arrays import AnyArray, Float64

_LOG2: Final = math.log(2.0)


def expose(
    colours: Tensor, log2_factors: Tensor, falloff: Tensor, stops: Tensor, levels: Tensor, slopes: Tensor
) -> Tensor:
    """Return the image (H, W, 3) of colours under a response; differentiable with respect to all but `stops`.

    Args:
        colours: (H, W, 3) float32 rendered colours.
        log2_factors: (3,) logarithms of gain and white balance of each channel.
        falloff: () vignetting, see `hybridworldsim.light.trained_response.TrainedResponse.vignetting`.
        stops: (K + 1,) logarithms of light at the knots of the curve; evenly spaced by one.
        levels: (K + 1,) logarithms of image values at the knots.
        slopes: (K,) slopes between the knots.
    """
    image: Tensor = _Expose.apply(colours, log2_factors, falloff, stops, levels, slopes)
    return image


@kernel()
def write_levels(
    levels_in: Any, shade: Any, factors: Any, first_stop: Any, darkest: Any, levels: Any, slopes: Any, begin: Any,
    end: Any, levels_out: Any,
) -> None:  # fmt: skip
    """Write the logarithms of image values of rows from those of colours; see `expose`."""
    last, knot = len(slopes) - 1, 0
    for row in range(begin, end):
        for column in range(levels_in.shape[1]):
            for channel in range(3):
                level = levels_in[row, column, channel]
                # The knot of the last pixel is near.
                while knot < last and level > levels[knot + 1]:
                    knot += 1
                while knot > 0 and level <= levels[knot]:
                    knot -= 1
                light = first_stop + knot + (level - levels[knot]) / slopes[knot]
                light = max(light + factors[channel] + shade[row, column], darkest) - first_stop
                other = min(max(math.ceil(light) - 1, 0), last)
                levels_out[row, column, channel] = levels[other] + slopes[other] * (light - other)


@kernel()
def write_gradients(
    levels_in: Any, shade: Any, factors: Any, first_stop: Any, darkest: Any, levels: Any, slopes: Any, gradients: Any,
    grad_levels: Any, grad_shade: Any, sums: Any,
) -> None:  # fmt: skip
    """Write the gradients with respect to the levels of colours and to the shade of pixels, and add to sums.

    The sums belong to three factors, K + 1 levels of knots, and K slopes.
    """
    last, first_level, knot = len(slopes) - 1, 3, 0
    first_slope = first_level + len(levels)
    for row in range(len(levels_in)):
        for column in range(levels_in.shape[1]):
            grad_shade[row, column] = 0.0
            for channel in range(3):
                level, grad = levels_in[row, column, channel], gradients[row, column, channel]
                # The knot of the last pixel is near.
                while knot < last and level > levels[knot + 1]:
                    knot += 1
                while knot > 0 and level <= levels[knot]:
                    knot -= 1
                share = (level - levels[knot]) / slopes[knot]
                light = first_stop + knot + share + factors[channel] + shade[row, column]
                is_dark = light < darkest
                light = max(light, darkest) - first_stop
                other = min(max(math.ceil(light) - 1, 0), last)
                sums[first_level + other] += grad
                sums[first_slope + other] += grad * (light - other)
                through = 0.0 if is_dark else grad * slopes[other]
                sums[channel] += through
                grad_shade[row, column] += through
                back = through / slopes[knot]
                sums[first_level + knot] -= back
                sums[first_slope + knot] -= back * share
                grad_levels[row, column, channel] = back


class _Expose(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, colours: Tensor, factors: Tensor, falloff: Tensor, stops: Tensor, levels: Tensor, slopes: Tensor
    ) -> Tensor:
        height, width = colours.shape[:2]
        shaded = 1.0 + falloff.detach() * corner_squares(height, width)
        numbers = (
            colours.detach().clamp_min(DARKEST).log2_().contiguous().numpy(), shaded.log2().mul_(-2.0).numpy(),
            _float64(factors), float(stops[0]), math.log2(DARKEST), _float64(levels), _float64(slopes),
        )  # fmt: skip
        image: AnyArray = empty_aligned(colours.numel()).reshape(colours.shape)
        in_row_spans(lambda begin, end: write_levels(*numbers, begin, end, image), height)
        exposed = torch.from_numpy(image).exp2_()
        ctx.numbers = numbers
        ctx.save_for_backward(colours, shaded, exposed)
        return exposed

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        colours, shaded, exposed = ctx.saved_tensors
        *_, levels, _ = ctx.numbers
        of_levels = (gradients[0] * exposed).mul_(_LOG2).contiguous().numpy()
        grad_levels, grad_shade = np.empty_like(of_levels), np.empty(of_levels.shape[:2], np.float32)
        # All rows at once: the sums do not depend on the number of threads.
        sums: Float64 = np.zeros(3 + 2 * len(levels) - 1)
        write_gradients(*ctx.numbers, of_levels, grad_levels, grad_shade, sums)  # type: ignore[call-arg]
        grad_colours = torch.from_numpy(grad_levels) / (colours * _LOG2)
        grad_falloff = -2.0 / _LOG2 * (torch.from_numpy(grad_shade) * corner_squares(*shaded.shape) / shaded).sum()
        totals = torch.from_numpy(sums).float()
        knots = 3 + len(levels)
        known = torch.where(colours < DARKEST, 0.0, grad_colours)
        return known, totals[:3], grad_falloff, None, totals[3:knots], totals[knots:]


@lru_cache(maxsize=16)
def corner_squares(height: int, width: int) -> Tensor:
    """Return the squares (H, W) of the distances of pixels from the middle of an image; 1 in its corners."""
    y = torch.arange(height) + 0.5 - 0.5 * height
    x = torch.arange(width) + 0.5 - 0.5 * width
    return (x.square()[None] + y.square()[:, None]) / (0.25 * (height * height + width * width))


def _float64(tensor: Tensor) -> Float64:
    return np.ascontiguousarray(tensor.detach().numpy(), np.float64)
