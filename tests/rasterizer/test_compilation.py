"""A cached kernel is compiled again after a change of the sources that it is made of, and only then."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import hybridworldsim

PACKAGE = Path(hybridworldsim.__file__).parent
CALL_KERNELS = """
import json
import numpy as np
from hybridworldsim.model import visible
from hybridworldsim.rasterizer.cpu.blending import sorting
assert sorting.depth_order(np.linspace(1.0, 0.0, 5000, dtype=np.float32))[0] == 4999
numbers = np.zeros(21, np.float32)
assert visible.find_visible(0, 0, numbers.reshape(7, 3), numbers, numbers, np.zeros(7, np.int64)) == 0
kernels = {"rasterizer": sorting._count, "model": visible.find_visible}
print(json.dumps({name: sum(one.stats.cache_misses.values()) for name, one in kernels.items()}))
"""
COUNT_FILES = """
import sys
import numba, torch
files = set()
sys.addaudithook(lambda event, arguments: files.add(str(arguments[0])) if event == "open" else None)
import hybridworldsim.rasterizer
import hybridworldsim.rasterizer.cpu
print(len(files))
"""


def _run(code: str, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], env=os.environ | environment, capture_output=True, text=True, check=True
    )
    return done.stdout


@pytest.fixture
def compiled(tmp_path):
    """A copy of the package, and a function that calls kernels of it and returns how many it compiled, by package."""
    copy = tmp_path / "hybridworldsim"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])

    def compile_again(edited: str | None = None) -> dict[str, int]:
        if edited is not None:
            file = copy / edited
            file.write_text(file.read_text() + "\n# edited\n")
        return json.loads(_run(CALL_KERNELS, PYTHONPATH=path, NUMBA_CACHE_DIR=str(tmp_path / "cache")))

    return compile_again


def test_a_change_of_a_source_file_compiles_the_kernels_that_may_contain_it_again(compiled):
    every = {"rasterizer": 1, "model": 1}
    assert compiled() == every
    # The rasterizer's kernel comes from the cache.
    assert compiled("model/decoders.py") == {"rasterizer": 0, "model": 1}
    assert compiled("kernels/simd.py") == every
    assert compiled("rasterizer/presets.py") == every


def test_importing_the_rasterizer_and_its_kernels_reads_fewer_than_200_files():
    assert 0 < int(_run(COUNT_FILES)) < 200
