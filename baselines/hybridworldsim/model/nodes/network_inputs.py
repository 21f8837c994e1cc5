"""The rows of a node that a viewpoint sees, as networks take them: compiled, with gradients."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.memory import empty_aligned
from hybridworldsim.kernels.threads import in_parallel, spans
from mirror.arrays import AnyArray

_MULTIPLE: Final = 4


def select_rows(node: nn.Module, names: Sequence[str], ids: Tensor, at_hand: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Rows (M, ...) of tables of a node, by name; those at hand are taken as they are."""
    return {name: at_hand[name] if name in at_hand else node.get_parameter(name).index_select(0, ids) for name in names}


def network_inputs(codes: Tensor, means: Tensor, eye: Tensor, radius_m: float | None = None) -> Tensor:
    """What a network is told: codes, the directions in which the camera sees them, and where they are.

    Args:
        codes: (M, F); it alone gets a gradient.
        means: (M, 3) in the block's frame, metres.
        eye: (3,) the camera, in the same.
        radius_m: of the block, in whose units the places are told; None: they are not.

    Returns:
        (M, D): the code, three numbers of direction, three of place if they are told, a one, and zeros up to a multiple
        of four, which products of matrices like.
    """
    found: Tensor = _NetworkInputs.apply(codes, means, eye, radius_m)
    return found


class _NetworkInputs(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, codes: Tensor, means: Tensor, eye: Tensor, radius_m: float | None) -> Tensor:
        given = _array(codes), _array(means), _array(eye)
        ctx.size = codes.shape[1]
        width = ctx.size + (4 if radius_m is None else 7)
        width += -width % _MULTIPLE
        out = empty_aligned(len(codes) * width).reshape(len(codes), width)
        share = np.float32(0.0 if radius_m is None else 1.0 / radius_m)
        edges = spans(len(codes))
        in_parallel(lambda part: write_network_inputs(edges[part], edges[part + 1], *given, share, out), len(edges) - 1)
        return torch.from_numpy(out)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        return gradients[0][:, : ctx.size], None, None, None


@kernel()
def write_network_inputs(begin: Any, end: Any, codes: Any, means: Any, eye: Any, share: Any, out: Any) -> None:
    """Write what is told of rows in a range; `share` is of a metre in the radius, 0 if places are not told."""
    size = codes.shape[1]
    for place in range(begin, end):
        row = np.uint64(place)
        for number in range(size):
            out[row, np.uint64(number)] = codes[row, np.uint64(number)]
        x, y, z = means[row, 0] - eye[0], means[row, 1] - eye[1], means[row, 2] - eye[2]
        length = np.float32(1.0) / np.float32(math.sqrt(max(x * x + y * y + z * z, np.float32(1e-24))))
        out[row, size], out[row, size + 1], out[row, size + 2] = x * length, y * length, z * length
        if share > 0.0:
            for axis in range(3):
                out[row, size + 3 + axis] = means[row, axis] * share
        past = size + (6 if share > 0.0 else 3)
        out[row, past] = np.float32(1.0)
        for number in range(past + 1, out.shape[1]):
            out[row, np.uint64(number)] = np.float32(0.0)


def _array(tensor: Tensor) -> AnyArray:
    return np.ascontiguousarray(tensor.detach().numpy())
