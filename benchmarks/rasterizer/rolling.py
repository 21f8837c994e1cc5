"""Measures what a rolling shutter costs: pairs of calls in one run, against the unscented path and the default path."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np
import torch

from benchmarks.rasterizer.views import View
from benchmarks.report import Row
from hybridworldsim.rasterizer import RollingShutterType
from hybridworldsim.rasterizer.rolling_shutter import rotation_at

TIME_BAR: Final = 1.3
"""Of the unscented path without a rolling shutter."""

_TRAVEL_M: Final = 0.45  # 15 m/s and 30 ms of readout
_TURN_RAD: Final = 0.01  # 20 degrees a second


def rolling_rows(view: View, repeats: int) -> Iterator[Row]:
    """Yield the times of one view through the default, the unscented and the rolling path, and their ratios.

    The calls alternate; a ratio is the median of the ratios of neighbouring calls.
    """
    start = torch.from_numpy(np.ascontiguousarray(view.scene.viewmat, np.float32))
    end = start.clone()
    turn = rotation_at(torch.tensor([0.0, _TURN_RAD, 0.0]).double(), torch.tensor(1.0).double()).float()
    end[:3] = turn @ start[:3]
    end[2, 3] -= _TRAVEL_M
    ends = end[None].requires_grad_()
    rolling = {"with_ut": True, "rolling_shutter": RollingShutterType.ROLLING_TOP_TO_BOTTOM, "viewmats_rs": ends}
    paths = {
        "default": view,
        "unscented": replace(view, options={"with_ut": True}),
        "unscented, antialiased": replace(view, options={"with_ut": True, "rasterize_mode": "antialiased"}),
        "rolling": replace(view, options=rolling),
    }
    tensors = view.tensors(gradients=True)
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in paths}
    for _ in range(repeats + 1):
        for name, path in paths.items():
            for tensor in (*tensors.values(), ends):
                tensor.grad = None
            begin = time.process_time()
            image, alphas, _ = path.render(tensors)
            middle = time.process_time()
            torch.autograd.backward([image, alphas], list(view.weights))
            times[name].append((middle - begin, time.process_time() - middle))
    measured = {name: 1e3 * np.array(values[1:]) for name, values in times.items()}
    for name, values in measured.items():
        forward, backward = np.median(values, axis=0)
        yield Row(f"{view.scene.name}, {name}, forward (CPU time)", view.size, float(forward))
        yield Row(f"{view.scene.name}, {name}, backward (CPU time)", view.size, float(backward))
    for other in ("unscented", "default"):
        ratio = np.median(measured["rolling"].sum(1) / measured[other].sum(1))
        yield Row(
            f"{view.scene.name}, rolling / {other}, forward and backward (ratio)",
            view.size,
            float(ratio),
            bar=TIME_BAR if other == "unscented" else None,
        )
        forward_ratio = np.median(measured["rolling"][:, 0] / measured[other][:, 0])
        yield Row(f"{view.scene.name}, rolling / {other}, forward (ratio)", view.size, float(forward_ratio),
                  bar=TIME_BAR if other == "unscented" else None)  # fmt: skip
