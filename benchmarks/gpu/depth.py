"""Depth without networks on a device: a plane sweep, fusion and the sky, and how far the compiled kernels are apart."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from benchmarks.gpu.machine import Machine
from benchmarks.gpu.quantities import BUDGETS_S
from benchmarks.plain_torch.facade import make_images, true_depth
from hybridworldsim.kernels.dispatch import plain_torch
from hybridworldsim.mvs.fusion import PosedDepth, confirm
from hybridworldsim.mvs.plane_sweep import PlaneSweep
from hybridworldsim.mvs.sky import find_sky

_NEAR_M, _FAR_M = 2.0, 200.0
_SHARE: Final = 1e-3
_MOST: Final = 20


def measure_depth(machine: Machine) -> dict[str, float]:
    """Time depth of full size, and compare a small image's with that of the kernels.

    On a CPU plain torch computes, as on a GPU.
    """
    width, height = machine.size_px()
    reference, sources = make_images(width, height)
    maps = [PosedDepth(true_depth(one), one.K, one.world_SE3_camera) for one in (reference, *sources, *sources)]
    sweep, each_s = PlaneSweep(device=machine.device), 0.2 * BUDGETS_S["depth"]
    with plain_torch():
        found = {
            "plane sweep of an image, 960x540, 160 planes, four sources": machine.median_ms(
                lambda: sweep(reference, sources, _NEAR_M, _FAR_M), each_s, most=_MOST
            ),
            "fusion with eight depth maps": machine.median_ms(
                lambda: confirm(maps[0], maps[1:], device=machine.device), each_s, most=_MOST
            ),
            "mask of the sky": machine.median_ms(
                lambda: find_sky(reference, maps[0].depth_m, machine.device), each_s, most=_MOST
            ),
        }
        small, beside = make_images(*machine.size_px(240, 135))
        depth_m = sweep(small, beside, _NEAR_M, _FAR_M).depth_m
    expected = replace(sweep, device="cpu")(small, beside, _NEAR_M, _FAR_M).depth_m
    agrees = np.isclose(depth_m, expected, rtol=_SHARE, atol=0.0, equal_nan=True)
    found["pixels whose depth is not that of the kernels"] = float(1.0 - agrees.mean())
    return found
