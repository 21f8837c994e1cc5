"""Measures time and error of metrics, for MIRROR and its peers, on one thread.

``python -m benchmarks metrics [--only GROUP ...]`` with the groups images, features and boxes. Bars on time are ratios:
a required share of the named peer's time, times what the peer takes in this run. Peers: ``pip install '.[bench]'``, and
``pip install --no-deps piq`` (its torchvision cannot be imported beside a CPU torch). An absent peer is left out with a
note.
"""

from __future__ import annotations

import argparse
import importlib
import os
import sys
from typing import Final

from benchmarks.report import report

GROUPS: Final = ("images", "features", "boxes")
_ONE_THREAD: Final = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}


def main(argv: list[str]) -> int:
    """Run the selected groups."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks metrics", description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=GROUPS, default=GROUPS, help="what to measure")
    chosen = parser.parse_args(argv)
    if any(os.environ.get(name) != value for name, value in _ONE_THREAD.items()):
        # Libraries read these when they are loaded.
        command = [sys.executable, "-m", "benchmarks", "metrics", *argv]
        os.execve(sys.executable, command, os.environ | _ONE_THREAD)
    groups = {name: importlib.import_module(f"benchmarks.metrics.{name}").rows() for name in chosen.only}
    return report("metrics", groups, errors="error (as the rows say)")
