"""The rows of a node that a viewpoint sees, as networks and the rasterizer take them: compiled, with gradients."""

from __future__ import annotations

import math
from typing import Any, Final

import numba
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from hybridworldsim.rasterizer.cpu.machine.memory import room
from hybridworldsim.rasterizer.cpu.machine.threads import in_parallel, spans
from hybridworldsim.rasterizer.cpu.tables import scattered
from mirror.arrays import AnyArray

_MULTIPLE: Final = 4


def told(codes: Tensor, rows: Tensor, means: Tensor, eye: Tensor, radius_m: float | None = None) -> Tensor:
    """What a network is told: codes, the directions in which the camera sees them, and where they are.

    Args:
        codes: (N, F) of all; it alone gets a gradient.
        rows: (M,) int64 of those that are seen, ascending, each once.
        means: (N, 3) in the block's frame, metres.
        eye: (3,) the camera, in the same.
        radius_m: of the block, in whose units the places are told; None: they are not.

    Returns:
        (M, D): the code, three numbers of direction, three of place if they are told, a one, and zeros up to a multiple
        of four, which products of matrices like.
    """
    found: Tensor = _Told.apply(codes, rows, means, eye, radius_m)
    return found


def shown(
    rows: Tensor, means: Tensor, quats: Tensor, log_scales: Tensor, logits: Tensor
) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Rows of the tables of Gaussians; differentiable to all of them.

    Args:
        rows: (M,) int64, ascending, each once.
        means: (N, 3).
        quats: (N, 4).
        log_scales: (N, 3).
        logits: (N,) of opacities.

    Returns:
        Means (M, 3), quats (M, 4), scales (M, 3), opacities (M,).
    """
    found: tuple[Tensor, Tensor, Tensor, Tensor] = _Shown.apply(rows, means, quats, log_scales, logits)
    return found


class _Told(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, codes: Tensor, rows: Tensor, means: Tensor, eye: Tensor, radius_m: float | None) -> Tensor:
        ctx.rows, ctx.shape = rows.numpy(), codes.shape
        given = _array(codes), ctx.rows, _array(means), _array(eye)
        width = codes.shape[1] + (4 if radius_m is None else 7)
        width += -width % _MULTIPLE
        out = room(len(rows) * width).reshape(len(rows), width)
        share = np.float32(0.0 if radius_m is None else 1.0 / radius_m)
        edges = spans(len(rows))
        in_parallel(lambda part: tell(edges[part], edges[part + 1], *given, share, out), len(edges) - 1)
        return torch.from_numpy(out)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        return torch.from_numpy(scattered(_array(gradients[0]), ctx.rows, ctx.shape)), None, None, None, None


class _Shown(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, rows: Tensor, means: Tensor, quats: Tensor, log_scales: Tensor, logits: Tensor
    ) -> tuple[Tensor, ...]:
        ids, tables = rows.numpy(), (means, quats, log_scales, logits)
        given = [_flat(_array(table)) for table in tables]
        out = [room(len(ids) * table.shape[1]).reshape(len(ids), table.shape[1]) for table in given]
        edges = spans(len(ids))
        in_parallel(lambda part: gather(edges[part], edges[part + 1], ids, *given, *out), len(edges) - 1)
        places, turned, scales, opacities = map(torch.from_numpy, out)
        scales.exp_()
        opacities = opacities.view(-1).sigmoid_()
        ctx.ids, ctx.shapes, ctx.scales, ctx.opacities = ids, [table.shape for table in tables], scales, opacities
        return places, turned, scales, opacities

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        to_means, to_quats, to_scales, to_opacities = gradients
        opacities = ctx.opacities
        own = to_means, to_quats, to_scales * ctx.scales, to_opacities * opacities * (1.0 - opacities)
        tables = (scattered(_flat(_array(one)), ctx.ids, shape) for one, shape in zip(own, ctx.shapes))
        return None, *map(torch.from_numpy, tables)


def _flat(table: AnyArray) -> AnyArray:
    return table.reshape(len(table), math.prod(table.shape[1:]))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def tell(begin: Any, end: Any, codes: Any, rows: Any, means: Any, eye: Any, share: Any, out: Any) -> None:
    """Write what is told of rows in a range; `share` is of a metre in the radius, 0 if places are not told."""
    size = codes.shape[1]
    for place in range(begin, end):
        row, to = np.uint64(rows[place]), np.uint64(place)
        for number in range(size):
            out[to, np.uint64(number)] = codes[row, np.uint64(number)]
        x, y, z = means[row, 0] - eye[0], means[row, 1] - eye[1], means[row, 2] - eye[2]
        length = np.float32(1.0) / np.float32(math.sqrt(max(x * x + y * y + z * z, np.float32(1e-24))))
        out[to, size], out[to, size + 1], out[to, size + 2] = x * length, y * length, z * length
        if share > 0.0:
            for axis in range(3):
                out[to, size + 3 + axis] = means[row, axis] * share
        past = size + (6 if share > 0.0 else 3)
        out[to, past] = np.float32(1.0)
        for number in range(past + 1, out.shape[1]):
            out[to, np.uint64(number)] = np.float32(0.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def gather(
    begin: Any, end: Any, rows: Any, means: Any, quats: Any, log_scales: Any, logits: Any,
    to_means: Any, to_quats: Any, to_scales: Any, to_logits: Any,
) -> None:  # fmt: skip
    """Copy rows in a range."""
    for place in range(begin, end):
        row, to = np.uint64(rows[place]), np.uint64(place)
        for axis in range(3):
            to_means[to, axis] = means[row, axis]
            to_scales[to, axis] = log_scales[row, axis]
        for part in range(4):
            to_quats[to, part] = quats[row, part]
        to_logits[to, 0] = logits[row, 0]


def _array(tensor: Tensor) -> AnyArray:
    return np.ascontiguousarray(tensor.detach().numpy())
