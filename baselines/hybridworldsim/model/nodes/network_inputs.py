"""The inputs of the networks for the rows of a node that a viewpoint sees: compiled, with gradients."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from hybridworldsim.kernels.compilation import kernel
from hybridworldsim.kernels.dispatch import is_compiled
from hybridworldsim.kernels.memory import empty_aligned
from hybridworldsim.kernels.threads import in_parallel, spans
from hybridworldsim.model.plain import decoding as plain
from mirror.arrays import AnyArray

_MULTIPLE: Final = 4


def select_rows(
    node: nn.Module, names: Sequence[str], ids: Tensor, gathered: Mapping[str, Tensor]
) -> dict[str, Tensor]:
    """Return rows (M, ...) of tables of a node, by name; tables that are already gathered are returned unchanged."""
    return {
        name: gathered[name] if name in gathered else node.get_parameter(name).index_select(0, ids) for name in names
    }


def network_inputs(codes: Tensor, means: Tensor, eye: Tensor, radius_m: float | None = None) -> Tensor:
    """Compute the inputs of a network: codes, viewing directions and, for anchors, places.

    Args:
        codes: (M, F); only the codes get a gradient.
        means: (M, 3) in the block's frame, metres.
        eye: (3,) centre of the camera, in the block's frame, metres.
        radius_m: radius of the block, the unit of the places; None: the inputs hold no places.

    Returns:
        (M, D): the code, three numbers of direction, three of place unless `radius_m` is None, a one, and zeros up to a
        multiple of four, which is faster in matrix products.
    """
    if not is_compiled(codes):
        return plain.network_inputs(codes, means, eye, radius_m)
    rows: Tensor = _NetworkInputs.apply(codes, means, eye, radius_m)
    return rows


class _NetworkInputs(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, codes: Tensor, means: Tensor, eye: Tensor, radius_m: float | None) -> Tensor:
        arrays = _array(codes), _array(means), _array(eye)
        ctx.size = codes.shape[1]
        width = ctx.size + (4 if radius_m is None else 7)
        width += -width % _MULTIPLE
        out = empty_aligned(len(codes) * width).reshape(len(codes), width)
        inverse_radius = np.float32(0.0 if radius_m is None else 1.0 / radius_m)
        edges = spans(len(codes))
        in_parallel(
            lambda part: write_network_inputs(edges[part], edges[part + 1], *arrays, inverse_radius, out),
            len(edges) - 1,
        )
        return torch.from_numpy(out)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        return gradients[0][:, : ctx.size], None, None, None


@kernel()
def write_network_inputs(begin: Any, end: Any, codes: Any, means: Any, eye: Any, inverse_radius: Any, out: Any) -> None:
    """Write the inputs of rows in a range; places are multiplied by `inverse_radius`, and left out if it is 0."""
    size = codes.shape[1]
    for place in range(begin, end):
        row = np.uint64(place)
        for number in range(size):
            out[row, np.uint64(number)] = codes[row, np.uint64(number)]
        x, y, z = means[row, 0] - eye[0], means[row, 1] - eye[1], means[row, 2] - eye[2]
        length = np.float32(1.0) / np.float32(math.sqrt(max(x * x + y * y + z * z, np.float32(1e-24))))
        out[row, size], out[row, size + 1], out[row, size + 2] = x * length, y * length, z * length
        if inverse_radius > 0.0:
            for axis in range(3):
                out[row, size + 3 + axis] = means[row, axis] * inverse_radius
        end_column = size + (6 if inverse_radius > 0.0 else 3)
        out[row, end_column] = np.float32(1.0)
        for number in range(end_column + 1, out.shape[1]):
            out[row, np.uint64(number)] = np.float32(0.0)


def _array(tensor: Tensor) -> AnyArray:
    return np.ascontiguousarray(tensor.detach().numpy())
