"""``python -m tests.processors``: run the numerical rooms once more as on other processors.

Results of a kernel may differ between processors in their last digits, never in a decision. Each row is one profile of
`PROFILES` with the tests that are run under it; the kernels of a profile are compiled once, and cached.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.processors import INSTRUCTION_SETS

ROOT = Path(__file__).resolve().parents[1]
ROOMS = (
    "tests/geometry",
    "tests/calibration/test_descriptors.py",
    "tests/calibration/test_estimate.py",
    "tests/calibration/test_refinement.py",
    "tests/calibration/test_statistics.py",
    "tests/metrics/images",
    "tests/mvs/test_plane_sweep.py",
    "tests/mvs/test_sparse.py",
    "tests/benchmarks/synth_matching",
)
"""Rooms whose decisions hang on products of matrices, eigenvectors and sums of many terms."""
_PLAIN = "without AVX-512, AVX2 and FMA"
PROFILES = {"BLAS kernels of Haswell": {"OPENBLAS_CORETYPE": "Haswell"}, _PLAIN: INSTRUCTION_SETS[_PLAIN]}
"""Environment variables of each profile. OpenBLAS takes its kernels of Haswell on most processors of AMD."""


def main() -> int:
    """Run the rooms under each profile; returns 1 if a test fails."""
    failed = []
    for name, features in PROFILES.items():
        begin = time.monotonic()
        command = [sys.executable, "-m", "pytest", "-n", "2", "-q", "-p", "no:cacheprovider", *ROOMS]
        code = subprocess.run(command, cwd=ROOT, env={**os.environ, **features}, check=False).returncode
        print(f"{name}: {'passed' if not code else 'FAILED'} in {time.monotonic() - begin:.0f} s", flush=True)
        failed += [name] if code else []
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
