"""A scene as a gsplat user has it: tensors, and the calls that render and differentiate them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.rasterizer.scenes import Splats
from hybridworldsim.rasterizer import rasterization

INPUTS = ("means", "quats", "scales", "opacities", "colors", "viewmats")


@dataclass(frozen=True, eq=False)
class View:
    """A view to render, with options.

    Attributes:
        scene: Gaussians and camera.
        width: pixels.
        height: pixels.
        channels: number of colour channels, without depth.
        spherical_harmonics: whether colours are spherical harmonics of degree 3.
        options: further arguments of `rasterization`.
    """

    scene: Splats
    width: int
    height: int
    channels: int = 3
    spherical_harmonics: bool = False
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the scene, with the options that differ from the defaults."""
        spherical_harmonics = ["SH 3"] if self.spherical_harmonics else []
        return ", ".join([self.scene.name, *spherical_harmonics, *(str(value) for value in self.options.values())])

    @property
    def size(self) -> str:
        """Size as printed in reports."""
        return f"{count_name(len(self.scene))} {self.width}x{self.height}"

    @cached_property
    def weights(self) -> tuple[Tensor, Tensor]:
        """Seeded gradients of image and alphas for the backward pass; depth has a hundredth of a colour's weight."""
        random = torch.Generator().manual_seed(0)
        image = torch.rand(1, self.height, self.width, self.channels + 1, generator=random)
        image[..., -1] *= 0.01
        return image, torch.rand(1, self.height, self.width, 1, generator=random)

    def tensors(self, dtype: torch.dtype = torch.float32, *, gradients: bool = False) -> dict[str, Tensor]:
        """Return the inputs by name, with the same values in any data type."""
        scene = self.scene
        colors = (
            scene.spherical_harmonics()
            if self.spherical_harmonics
            else np.tile(scene.colors, (1, 3))[:, : self.channels]
        )
        arrays = (scene.means, scene.quats, scene.scales, scene.opacities, colors, scene.viewmat[None])
        return {
            name: torch.from_numpy(np.ascontiguousarray(array, np.float32)).to(dtype).requires_grad_(gradients)
            for name, array in zip(INPUTS, arrays)
        }

    def render(self, tensors: dict[str, Tensor], backend: str = "cpu") -> tuple[Tensor, Tensor, dict[str, Any]]:
        """Return the colours and depth, (1, height, width, channels + 1), alphas and meta."""
        camera = torch.from_numpy(self.scene.camera_matrix(self.width, self.height))[None]
        arguments: dict[str, Any] = {
            **tensors,
            "Ks": camera.to(tensors["means"].dtype),
            "width": self.width,
            "height": self.height,
            "render_mode": "RGB+D",
            "sh_degree": 3 if self.spherical_harmonics else None,
            "backend": backend,
            **self.options,
        }
        return rasterization(**arguments)


def forward_ms(view: View, repeats: int) -> float:
    """Return the median warm time of an image without gradients."""
    tensors = view.tensors()
    times = []
    with torch.no_grad():
        for _ in range(repeats + 1):
            start = time.perf_counter()
            view.render(tensors)
            times.append((time.perf_counter() - start) * 1e3)
    return float(np.median(times[1:]))


def both_ms(view: View, repeats: int) -> tuple[float, float]:
    """Return the median warm times of an image with gradients enabled, and of its gradients to all inputs."""
    tensors, weights = view.tensors(gradients=True), view.weights
    times = []
    for _ in range(repeats + 1):
        for tensor in tensors.values():
            tensor.grad = None
        start = time.perf_counter()
        image, alphas, _ = view.render(tensors)
        middle = time.perf_counter()
        torch.autograd.backward([image, alphas], list(weights))
        times.append((middle - start, time.perf_counter() - middle))
    forward, backward = np.median(np.array(times[1:]) * 1e3, axis=0)
    return float(forward), float(backward)


def count_name(count: int) -> str:
    """Return a short name of a count: 100 k, 3 M."""
    return f"{count / 1e6:g} M" if count >= 1_000_000 else f"{count / 1e3:g} k"


@contextmanager
def with_threads(count: int) -> Iterator[None]:
    """Set the number of threads of torch, and with it of the rasterizer."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
