"""Functions that run as plain Python while their inputs are small, called from several threads of a new process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tests.conftest import ROOT

FUNCTION = """
@compiled_above(10_000)
def times_{0}(values):
    total = 0.0
    for value in values:
        total += {0} * value
    return total
"""
CALLS = """
import sys
from concurrent.futures import ThreadPoolExecutor
import numpy as np
import functions
sys.setswitchinterval(1e-6)
names = sorted(name for name in vars(functions) if name.startswith("times_"))
with ThreadPoolExecutor(6) as pool:
    found = list(pool.map(lambda name: getattr(functions, name)(np.ones(3)), names * 6))
assert found == [3.0 * int(name[6:]) for name in names] * 6, found
"""


def test_threads_may_call_at_one_time(tmp_path: Path) -> None:
    source = "from mirror.compiled import compiled_above\n" + "".join(FUNCTION.format(number) for number in range(40))
    (tmp_path / "functions.py").write_text(source)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": f"{tmp_path}:{ROOT}"}
    done = subprocess.run([sys.executable, "-c", CALLS], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
