"""A scene as a gsplat user holds it: tensors, and the call that renders or differentiates them."""

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
    """What is rendered, and how.

    Attributes:
        scene: Gaussians and camera.
        width: pixels.
        height: pixels.
        channels: of colour, without depth.
        harmonics: whether colours are spherical harmonics of degree 3.
        options: further arguments of `rasterization`.
    """

    scene: Splats
    width: int
    height: int
    channels: int = 3
    harmonics: bool = False
    options: dict[str, Any] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The scene's, and what is not as ever."""
        harmonics = ["SH 3"] if self.harmonics else []
        return ", ".join([self.scene.name, *harmonics, *(str(value) for value in self.options.values())])

    @property
    def size(self) -> str:
        """As reports print it."""
        return f"{count_name(len(self.scene))} {self.width}x{self.height}"

    @cached_property
    def weights(self) -> tuple[Tensor, Tensor]:
        """Gradients of image and alphas that backward begins with, seeded; a metre weighs a hundredth of a colour."""
        random = torch.Generator().manual_seed(0)
        picture = torch.rand(1, self.height, self.width, self.channels + 1, generator=random)
        picture[..., -1] *= 0.01
        return picture, torch.rand(1, self.height, self.width, 1, generator=random)

    def tensors(self, dtype: torch.dtype = torch.float32, *, gradients: bool = False) -> dict[str, Tensor]:
        """The inputs by their names, of the same values in any type."""
        scene = self.scene
        colors = scene.harmonics() if self.harmonics else np.tile(scene.colors, (1, 3))[:, : self.channels]
        arrays = (scene.means, scene.quats, scene.scales, scene.opacities, colors, scene.viewmat[None])
        return {
            name: torch.from_numpy(np.ascontiguousarray(array, np.float32)).to(dtype).requires_grad_(gradients)
            for name, array in zip(INPUTS, arrays)
        }

    def render(self, tensors: dict[str, Tensor], backend: str = "cpu") -> tuple[Tensor, Tensor, dict[str, Any]]:
        """Colours and depth, (1, height, width, channels + 1), alphas and meta."""
        camera = torch.from_numpy(self.scene.camera_matrix(self.width, self.height))[None]
        arguments: dict[str, Any] = {
            **tensors,
            "Ks": camera.to(tensors["means"].dtype),
            "width": self.width,
            "height": self.height,
            "render_mode": "RGB+D",
            "sh_degree": 3 if self.harmonics else None,
            "backend": backend,
            **self.options,
        }
        return rasterization(**arguments)


def forward_ms(view: View, repeats: int) -> float:
    """Median time of an image, warm, nothing kept for gradients."""
    tensors = view.tensors()
    times = []
    with torch.no_grad():
        for _ in range(repeats + 1):
            start = time.perf_counter()
            view.render(tensors)
            times.append((time.perf_counter() - start) * 1e3)
    return float(np.median(times[1:]))


def both_ms(view: View, repeats: int) -> tuple[float, float]:
    """Median times, warm, of an image that keeps what gradients need, and of its gradients to all inputs."""
    tensors, weights = view.tensors(gradients=True), view.weights
    times = []
    for _ in range(repeats + 1):
        for tensor in tensors.values():
            tensor.grad = None
        start = time.perf_counter()
        picture, alphas, _ = view.render(tensors)
        middle = time.perf_counter()
        torch.autograd.backward([picture, alphas], list(weights))
        times.append((middle - start, time.perf_counter() - middle))
    forward, backward = np.median(np.array(times[1:]) * 1e3, axis=0)
    return float(forward), float(backward)


def count_name(count: int) -> str:
    """Short: 100 k, 3 M."""
    return f"{count / 1e6:g} M" if count >= 1_000_000 else f"{count / 1e3:g} k"


@contextmanager
def with_threads(count: int) -> Iterator[None]:
    """Let torch, and with it the rasterizer, use so many threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
