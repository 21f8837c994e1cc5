"""A street for rendering alone: what does not change with the view is computed once, the rest by compiled kernels."""

from __future__ import annotations

from typing import Final

import numpy as np
import torch
from torch import Tensor

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

    Of the hidden layers, what comes of codes and places is the same in every view and is kept: 256 bytes an anchor with
    32 units.

    Args:
        node: as it was trained; later changes to it are not noticed.
    """

    def __init__(self, node: Anchors) -> None:
        self.k, self._count = node.k, len(node)
        self._means, self._offsets = _array(node.means), _array(node.offsets)
        self._sizes = _array(node.log_scales.exp())
        self._reach = _array(3.0 * node.log_scales.amax(1).exp() if len(node) else node.log_scales[:, 0])
        inputs = (node.codes, node.means / node.radius_m)
        layers = [_Layer(network, inputs) for network in (node.geometry, node.colour)]
        self._geometry, self._colour = layers
        self._base = np.concatenate([layer.base for layer in layers], axis=1).ravel()
        self._steer = np.concatenate([layer.steer for layer in layers], axis=1).ravel()
        self._last = [_wide(layer.out) for layer in layers]

    def __len__(self) -> int:
        return self._count

    def decode(self, viewpoint: Viewpoint, latent: Tensor, content: Tensor) -> Splats:
        """See `Anchors.decode`."""
        seen = seen_rows(viewpoint, self._means, self._reach)
        shared = np.concatenate([self._geometry.shared(content), self._colour.shared(latent)])
        eye = _array(viewpoint.centre)
        (tall, tall_bias), (wide, wide_bias) = self._last
        most = len(seen) * self.k
        columns = _columns(most)
        edges, counts = _edges(len(seen)), np.zeros(_PARTS, np.int64)

        def work(part: int) -> None:
            begin, end = edges[part], edges[part + 1]
            scratch = np.empty(len(shared) + len(tall_bias) + len(wide_bias), np.float32)
            into = [column[begin * self.k : end * self.k] for column in columns]
            counts[part] = decode_anchors(
                seen[begin:end], eye, self._means, self._offsets, self._sizes, self._base, shared, self._steer,
                tall, tall_bias, wide, wide_bias, scratch, *into,
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
        self._means = _array(node.means)
        self._reach = _array(3.0 * node.log_scales.amax(1).exp() if len(node) else node.logits)
        self._layer = _Layer(node.colour, (node.codes,))
        self._base, self._steer = self._layer.base.ravel(), self._layer.steer.ravel()
        self._out = self._layer.out[0].ravel()

    def __len__(self) -> int:
        return self._count

    def decode(self, viewpoint: Viewpoint, latent: Tensor) -> Splats:
        """See `CodeGaussians.decode`."""
        seen = seen_rows(viewpoint, self._means, self._reach)
        shared, eye = self._layer.shared(latent), _array(viewpoint.centre)
        colours = np.empty((len(seen), 3), np.float32)
        edges = _edges(len(seen))

        def work(part: int) -> None:
            span = slice(edges[part], edges[part + 1])
            decode_colours(
                seen[span], eye, self._means, self._base, shared, self._steer, self._out, self._layer.out[1],
                np.empty(len(shared), np.float32), colours[span],
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


class _Layer:
    """A `Conditioned` network whose inputs are those that views share, and the direction, given second.

    The hidden units are padded with ones that are always zero.

    Args:
        network: whose first input is the codes, whose second the direction.
        inputs: codes, and what follows the direction.
    """

    def __init__(self, network: Conditioned, inputs: tuple[Tensor, ...]) -> None:
        with torch.no_grad():
            matrices = [network.own[0], *list(network.own)[2:]]
            base = network.bias + sum(values @ matrix.T for values, matrix in zip(inputs, matrices, strict=True))
            self._pad = -base.shape[1] % WIDTH
            self.base = np.pad(_array(base), ((0, 0), (0, self._pad)))
            self.steer = np.pad(_array(network.own[1].T), ((0, 0), (0, self._pad)))
            self.out = np.pad(_array(network.out.weight), ((0, 0), (0, self._pad))), _array(network.out.bias)
            self._matrix = network.shared.detach().clone()

    def shared(self, latent: Tensor) -> Float32:
        """(H,) that an appearance adds to the hidden layer."""
        return np.pad(_array(self._matrix @ latent.detach()), (0, self._pad))


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


def _wide(out: tuple[Float32, Float32]) -> tuple[Float32, Float32]:
    """A last layer (M, H), (M,) with a row a hidden unit, flat, the outputs filled up to whole vectors."""
    weight, bias = out
    more = -len(bias) % WIDTH
    return np.ascontiguousarray(np.pad(weight.T, ((0, 0), (0, more)))).ravel(), np.pad(bias, (0, more))


def _edges(count: int) -> Int64:
    return np.linspace(0, count, _PARTS + 1).astype(np.int64)


def _array(table: Tensor) -> Float32:
    return np.ascontiguousarray(table.detach().numpy(), np.float32)
