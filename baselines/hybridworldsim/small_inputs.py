"""Calls with small inputs of compiled functions that `mirror compile` does not reach with its verbs."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import torch

from mirror.compiled import machine_code_only


def main() -> None:
    """Call the functions."""
    with machine_code_only():
        _render()


def _render() -> None:
    """Render spherical harmonics through a pinhole, a lens and a rolling shutter, and differentiate."""
    from hybridworldsim.rasterizer import RollingShutterType, rasterization
    from hybridworldsim.rasterizer.covers import covered_before

    random = torch.Generator().manual_seed(0)
    viewmats, ks = torch.eye(4)[None], torch.tensor([[[30.0, 0.0, 16.0], [0.0, 30.0, 16.0], [0.0, 0.0, 1.0]]])
    lens = {"with_ut": True, "packed": False, "radial_coeffs": torch.tensor([[-0.1, 0.02, 0.0, 0.0, 0.0, 0.0]])}
    later = viewmats.clone()
    later[:, 0, 3] = 0.1
    shutter = {"rolling_shutter": RollingShutterType.ROLLING_TOP_TO_BOTTOM, "viewmats_rs": later}
    camera = {"viewmats": viewmats, "Ks": ks, "width": 32, "height": 32}
    for dtype, more in product((torch.float32, torch.float64), ({}, lens, {**lens, **shutter})):
        shape = {
            "means": torch.randn(4, 3, generator=random) + torch.tensor([0.0, 0.0, 5.0]),
            "quats": torch.randn(4, 4, generator=random),
            "scales": torch.full((4, 3), 0.3),
            "opacities": torch.full((4,), 0.5),
            "colors": torch.rand(4, 4, 3, generator=random),
        }
        learnt = {name: part.to(dtype).requires_grad_() for name, part in shape.items()}
        arguments: dict[str, Any] = {**learnt, **camera, **more}
        shown, _, meta = rasterization(sh_degree=1, backend="cpu", **arguments)
        shown.sum().backward()
        if not more:
            # What of a street hides a road user of a rollout.
            covered_before(meta, np.full((32, 32), 9.0, np.float32))


if __name__ == "__main__":
    main()
