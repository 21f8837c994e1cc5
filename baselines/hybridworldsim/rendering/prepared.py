"""A street for rendering alone: what does not change with the view is computed once, the rest by compiled kernels."""

from __future__ import annotations

from typing import Final

import numpy as np
import torch
from torch import Tensor, nn

from hybridworldsim.rasterizer.cpu.machine.memory import room
from hybridworldsim.rasterizer.cpu.machine.threads import in_parallel
from hybridworldsim.rasterizer.cpu.machine.vectors import WIDTH
from hybridworldsim.rendering.kernels import decode_anchors, decode_colours, rows_seen
from hybridworldsim.scene.decoders import Conditioned
from hybridworldsim.scene.nodes.anchors import Anchors
from hybridworldsim.scene.nodes.code_gaussians import CodeGaussians
from hybridworldsim.scene.splats import Splats
from hybridworldsim.scene.street import Drawn, Street, draw
from hybridworldsim.scene.visible import NEAREST_M
from hybridworldsim.training.viewpoint import Viewpoint
from mirror.arrays import AnyArray, Float32, Int64

_PARTS: Final = 8


class PreparedAnchors:
    """`Anchors` that decode as those do, without gradients.

    Args:
        node: as it was trained; later changes to it are not noticed.
    """

    def __init__(self, node: Anchors) -> None:
        self.k, self._count, self._radius = node.k, len(node), np.float32(node.radius_m)
        self._means, self._offsets, self._codes = _array(node.means), _array(node.offsets), _array(node.codes)
        self._sizes = _array(node.log_scales.exp())
        self._reach = _array(3.0 * node.log_scales.amax(1).exp() if len(node) else node.log_scales[:, 0])
        self._networks = node.geometry, node.colour
        self._last = [_wide(network.out) for network in self._networks]

    def __len__(self) -> int:
        return self._count

    def decode(self, viewpoint: Viewpoint, latent: Tensor, content: Tensor) -> Splats:
        """See `Anchors.decode`."""
        seen = seen_rows(viewpoint, self._means, self._reach)
        layers = [_first(network, z) for network, z in zip(self._networks, (content, latent))]
        first, bias = np.concatenate([one for one, _ in layers], axis=1), np.concatenate([one for _, one in layers])
        eye = _array(viewpoint.centre)
        (tall, tall_bias), (wide, wide_bias) = self._last
        most = len(seen) * self.k
        columns = _columns(most)
        edges, counts = _edges(len(seen)), np.zeros(_PARTS, np.int64)

        def work(part: int) -> None:
            begin, end = edges[part], edges[part + 1]
            scratch = np.zeros(len(bias) + len(tall_bias) + len(wide_bias) + len(first), np.float32)
            into = [column[begin * self.k : end * self.k] for column in columns]
            counts[part] = decode_anchors(
                seen[begin:end], eye, self._means, self._offsets, self._sizes, self._codes, self._radius,
                first.ravel(), bias, tall, tall_bias, wide, wide_bias, scratch, *into,
            )  # fmt: skip

        in_parallel(work, _PARTS)
        spans = [(begin * self.k, begin * self.k + count) for begin, count in zip(edges, counts)]
        means, quats, scales, opacities, colours, rows = (
            torch.from_numpy(np.concatenate([column[begin:end] for begin, end in spans])) for column in columns
        )
        return Splats(
            means, quats, scales, opacities, colours, rows, self._count * self.k, most, torch.from_numpy(seen)
        )


class PreparedCodeGaussians:
    """`CodeGaussians` that decode as those do, without gradients.

    Args:
        node: as it was trained; later changes to it are not noticed.
    """

    def __init__(self, node: CodeGaussians) -> None:
        self._count = len(node)
        self._tables = tuple(
            table.detach().clone() for table in (node.means, node.quats, node.log_scales.exp(), node.logits.sigmoid())
        )
        self._means, self._codes = _array(node.means), _array(node.codes)
        self._reach = _array(3.0 * node.log_scales.amax(1).exp() if len(node) else node.logits)
        self._network = node.colour
        self._last = _padded(node.colour.out.weight).ravel(), _array(node.colour.out.bias)

    def __len__(self) -> int:
        return self._count

    def decode(self, viewpoint: Viewpoint, latent: Tensor) -> Splats:
        """See `CodeGaussians.decode`."""
        seen = seen_rows(viewpoint, self._means, self._reach)
        (first, bias), eye = _first(self._network, latent), _array(viewpoint.centre)
        colours = np.empty((len(seen), 3), np.float32)
        edges = _edges(len(seen))

        def work(part: int) -> None:
            span = slice(edges[part], edges[part + 1])
            decode_colours(
                seen[span], eye, self._means, self._codes, first.ravel(), bias, *self._last,
                np.zeros(len(bias) + len(first), np.float32), colours[span],
            )  # fmt: skip

        in_parallel(work, _PARTS)
        rows = torch.from_numpy(seen)
        means, quats, scales, opacities = (table[rows] for table in self._tables)
        return Splats(means, quats, scales, opacities, torch.from_numpy(colours), rows, self._count, len(seen))


class PreparedStreet:
    """A street for rendering alone.

    Args:
        street: as it was trained; later changes to it are not noticed.
    """

    def __init__(self, street: Street) -> None:
        self.background = PreparedAnchors(street.background)
        self.ground, self.sky = PreparedCodeGaussians(street.ground), PreparedCodeGaussians(street.sky)
        self.appearance = street.appearance

    @torch.inference_mode()
    def __call__(self, viewpoint: Viewpoint, latent: Tensor, content: Tensor | None = None) -> Drawn:
        """See `Street.forward`."""
        return draw(viewpoint, self.decode(viewpoint, latent, latent if content is None else content))

    def decode(self, viewpoint: Viewpoint, latent: Tensor, content: Tensor) -> tuple[Splats, ...]:
        """See `Street.decode`."""
        return (
            self.background.decode(viewpoint, latent, content),
            self.ground.decode(viewpoint, latent),
            self.sky.decode(viewpoint, latent),
        )


def seen_rows(viewpoint: Viewpoint, means: Float32, reach_m: Float32) -> Int64:
    """Rows whose sphere a view's pyramid may meet, ascending; see `hybridworldsim.scene.visible.visible`."""
    view = _view(viewpoint)
    rows = np.empty(len(means), np.int64)
    edges, counts = _edges(len(means)), np.zeros(_PARTS, np.int64)

    def work(part: int) -> None:
        counts[part] = rows_seen(edges[part], edges[part + 1], means, reach_m, view, rows)

    in_parallel(work, _PARTS)
    return np.concatenate([rows[begin : begin + count] for begin, count in zip(edges, counts)])


def _view(viewpoint: Viewpoint) -> Float32:
    """(21,) what `rows_seen` asks of a viewpoint."""
    K, matrix = viewpoint.K.double().numpy(), viewpoint.viewmat.numpy()
    slopes = [
        slope
        for axis, size in ((0, viewpoint.width_px), (1, viewpoint.height_px))
        for slope in (K[axis, 2] / K[axis, axis], (size - K[axis, 2]) / K[axis, axis])
    ]
    lengths = [(1.0 + slope * slope) ** 0.5 for slope in slopes]
    numbers = (*matrix[:3, :3].ravel(), *matrix[:3, 3], NEAREST_M, *slopes, *lengths)
    return np.array(numbers, np.float32)


def _columns(most: int) -> tuple[AnyArray, ...]:
    """Room for centres, rotations, scales, opacities, colours and rows of Gaussians."""
    shapes = ((most, 3), (most, 4), (most, 3), (most,), (most, 3))
    return (*(room(int(np.prod(shape))).reshape(shape) for shape in shapes), room(most, np.int64))


def _first(network: Conditioned, latent: Tensor) -> tuple[Float32, Float32]:
    """A first layer under an appearance: (D, H) with a row a number of the input, one of zeros if D were odd; (H,)."""
    matrix, bias = network.first(latent)
    table = _padded(matrix.T)
    return np.pad(table, ((0, len(table) % 2), (0, 0))), _padded(bias[None])[0]


def _wide(out: nn.Linear) -> tuple[Float32, Float32]:
    """A last layer with a row a hidden unit, flat, and its bias."""
    weight = _padded(out.weight.T)
    return np.pad(weight, ((0, -len(weight) % WIDTH), (0, 0))).ravel(), _padded(out.bias[None])[0]


def _padded(table: Tensor) -> Float32:
    """A table (N, M) whose rows are filled up with zeros to whole vectors."""
    return np.pad(_array(table), ((0, 0), (0, -table.shape[1] % WIDTH)))


def _edges(count: int) -> Int64:
    return np.linspace(0, count, _PARTS + 1).astype(np.int64)


def _array(table: Tensor) -> Float32:
    return np.ascontiguousarray(table.detach().numpy(), np.float32)
