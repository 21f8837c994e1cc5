"""Calls with small inputs of compiled functions that `mirror compile` does not reach with its verbs."""

from __future__ import annotations

from itertools import product
from typing import Any

import torch

from mirror.compiled import machine_code_only


def main() -> None:
    """Call the functions."""
    with machine_code_only():
        _render()


def _render() -> None:
    """Render spherical harmonics through a pinhole, a lens and a rolling shutter, and differentiate."""
    from hybridworldsim.rasterizer import RollingShutterType, rasterization

    random = torch.Generator().manual_seed(0)
    viewmats, ks = torch.eye(4)[None], torch.tensor([[[30.0, 0.0, 16.0], [0.0, 30.0, 16.0], [0.0, 0.0, 1.0]]])
    lens = {"with_ut": True, "packed": False, "radial_coeffs": torch.tensor([[-0.1, 0.02, 0.0, 0.0, 0.0, 0.0]])}
    later = viewmats.clone()
    later[:, 0, 3] = 0.1
    shutter = {"rolling_shutter": RollingShutterType.ROLLING_TOP_TO_BOTTOM, "viewmats_rs": later}
    for dtype, more in product((torch.float32, torch.float64), ({}, lens, {**lens, **shutter})):
        means, quats = (torch.randn(4, size, generator=random) for size in (3, 4))
        shape = [means + torch.tensor([0.0, 0.0, 5.0]), quats, torch.full((4, 3), 0.3), torch.full((4,), 0.5)]
        colors = torch.rand(4, 4, 3, generator=random)
        parts = [part.to(dtype).requires_grad_() for part in (*shape, colors)]
        arguments: dict[str, Any] = {"sh_degree": 1, "backend": "cpu", **more}
        shown, _, _ = rasterization(*parts, viewmats, ks, 32, 32, **arguments)
        shown.sum().backward()


if __name__ == "__main__":
    main()
