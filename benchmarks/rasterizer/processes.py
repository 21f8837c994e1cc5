"""Measures in new processes: the time of the first image, and the memory of the largest."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.rasterizer.scenes import Splats

_START = """
import time
import torch
from benchmarks.rasterizer import scenes
from benchmarks.rasterizer.views import View
from hybridworldsim.rasterizer import rasterization
one = torch.ones(1, requires_grad=True)
torch.autograd.backward([one * 1], [torch.ones(1)])  # torch's own first one imports for half a second
start = time.perf_counter()
view = View(scenes.random(100), 64, 48)
tensors = view.tensors(gradients=True)
image, alphas, _ = view.render(tensors)
torch.autograd.backward([image, alphas], list(view.weights))
print(time.perf_counter() - start)
"""

_PEAK = """
import sys
from pathlib import Path
import numpy as np
import torch
from benchmarks.rasterizer import scenes
from benchmarks.rasterizer.scenes import Splats
from benchmarks.rasterizer.views import View

def status(field):
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith(field))

def both(view, tensors, backward):
    with torch.set_grad_enabled(backward):
        image, alphas, _ = view.render(tensors)
    if backward:
        torch.autograd.backward([image, alphas], list(view.weights))

file, width, height, backward = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4] == "backward"
small = View(scenes.random(100), 64, 48)
both(small, small.tensors(gradients=backward), backward)
with np.load(file) as arrays:
    scene = Splats("", **{name: arrays[name] for name in arrays.files if name != "focal"}, focal=tuple(arrays["focal"]))
view = View(scene, width, height)
tensors, _ = view.tensors(gradients=backward), view.weights
Path("/proc/self/clear_refs").write_text("5")
before = status("VmRSS")
both(view, tensors, backward)
print(status("VmHWM") - before)
"""


@dataclass(frozen=True)
class StartTimes:
    """Seconds until the first small image and its gradients.

    Attributes:
        compiled: with an empty cache of compiled kernels.
        cached: in the next process, with the filled cache.
    """

    compiled: float
    cached: float


def measure_starts() -> StartTimes:
    """Start two processes with a new cache; imports do not count."""
    with tempfile.TemporaryDirectory() as cache:
        own = {"NUMBA_CACHE_DIR": cache}
        return StartTimes(float(_child(_START, environment=own)), float(_child(_START, environment=own)))


def measure_peak_bytes(scene: Splats, width: int, height: int, *, backward: bool) -> int:
    """Return the increase of the process memory by an image, with or without its gradients, over inputs and code."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.npz"
        arrays = {name: getattr(scene, name) for name in ("means", "quats", "scales", "opacities", "colors", "viewmat")}
        np.savez(file, focal=np.array(scene.focal), **arrays)
        return int(_child(_PEAK, str(file), str(width), str(height), "backward" if backward else "forward"))


def _child(code: str, *arguments: str, environment: Mapping[str, str] | None = None) -> str:
    command = [sys.executable, "-c", code, *arguments]
    done = subprocess.run(
        command, check=True, stdout=subprocess.PIPE, text=True, env={**os.environ, **(environment or {})}
    )
    return done.stdout.splitlines()[-1]
