"""Lists what a machine with a GPU and no network needs, and the commands to run there."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final

from benchmarks.gpu.quantities import METHODS
from benchmarks.gpu.streets import StreetData
from mirror.devices import GSPLAT_RELEASES

ROOT: Final = Path(__file__).resolve().parents[2]
EXTRAS: Final = "models,gpu"
"""The extras of this package that the benchmark needs."""

_GSPLAT: Final = "1.5.3"
_ARCHITECTURES: Final = {"A100": "8.0", "RTX 3090": "8.6", "RTX 4090, L4": "8.9", "H100, H200": "9.0", "B200": "10.0"}
"""Architectures for which gsplat is built, by GPU."""


def describe_needs(street: StreetData) -> str:
    """Return the commands that collect what is needed, on a machine with a network, and those to run without one.

    Args:
        street: the street, which is made.
    """
    size_gb = sum(path.stat().st_size for path in street.folder.rglob("*") if path.is_file()) / 1e9
    wanted = " or ".join(GSPLAT_RELEASES)
    known = ", ".join(f"{gpu}: {number}" for gpu, number in _ARCHITECTURES.items())
    methods = "\n".join(f"  python -m benchmarks gpu --full {method}" for method in METHODS)
    return f"""
Bring to the machine with the GPU:
1. this checkout ({ROOT}), with the street in it ({street.folder}, {size_gb:.2f} GB);
2. wheels, collected where there is a network, by the same version of Python. torch first, from the index of its build
   for the CUDA version of the GPU's driver (here: torch {_installed("torch")}):
  pip download --dest wheels torch
  pip download --dest wheels setuptools ninja jaxtyping
  pip wheel --wheel-dir wheels --find-links wheels '.[models]'
3. gsplat {wanted} (here: {_installed("gsplat")}), built once with the CUDA toolkit of torch's version,
   where torch is installed, for the architecture of the GPU ({known}):
  TORCH_CUDA_ARCH_LIST=9.0 pip wheel --wheel-dir wheels --no-build-isolation --no-deps gsplat=={_GSPLAT}
There, without a network:
  python -m venv .venv && . .venv/bin/activate
  pip install --no-index --find-links wheels setuptools
  pip install --no-index --find-links wheels --no-build-isolation -e '.[{EXTRAS}]'
  python -m benchmarks gpu
{methods}
Each call prints the device first; a device that cannot be used is named with what to install. The results are
docs/gpu/DEVICE.json and the table of docs/performance.md."""


def _installed(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
