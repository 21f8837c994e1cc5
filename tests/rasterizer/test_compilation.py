"""A cached kernel is compiled again after a change of the sources that it is made of, and only then."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import hybridworldsim

PACKAGE = Path(hybridworldsim.__file__).parent
# Imports the large libraries once; each line of its input is a program, which a fork of it runs.
FORKS = """
import json, os, sys
import numba, numpy, torch
for line in sys.stdin:
    if os.fork() == 0:
        exec(json.loads(line))
        sys.stdout.flush()
        os._exit(0)
    if os.wait()[1]:
        sys.exit(1)
"""
CALL_KERNELS = """
import json, sys
sys.path.insert(0, {folder!r})
import numpy as np
from hybridworldsim.model import visible
from hybridworldsim.rasterizer.cpu.blending import sorting
assert sorting.__file__.startswith({folder!r})
assert sorting.depth_order(np.linspace(1.0, 0.0, 5000, dtype=np.float32))[0] == 4999
numbers = np.zeros(21, np.float32)
assert visible.find_visible(0, 0, numbers.reshape(7, 3), numbers, numbers, np.zeros(7, np.int64)) == 0
kernels = {{"rasterizer": sorting._count, "model": visible.find_visible}}
print(json.dumps({{name: sum(one.stats.cache_misses.values()) for name, one in kernels.items()}}))
"""
COUNT_FILES = """
import sys
files = set()
sys.addaudithook(lambda event, arguments: files.add(str(arguments[0])) if event == "open" else None)
import hybridworldsim.rasterizer
import hybridworldsim.rasterizer.cpu
print(len(files))
"""
Run = Callable[[str], str]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    """Runs a program in a process that has imported the large libraries, none of ours, and returns what it prints."""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path_factory.mktemp("kernels"))}
    forks = subprocess.Popen(
        [sys.executable, "-c", FORKS], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )

    def run(code: str) -> str:
        assert forks.stdin is not None and forks.stdout is not None
        print(json.dumps(code), file=forks.stdin, flush=True)
        line = forks.stdout.readline()
        assert line, "the program failed: its traceback is above"
        return line

    with forks:
        yield run


@pytest.fixture
def compiled(tmp_path: Path, run: Run) -> Callable[..., dict[str, int]]:
    """Edits a copy of the package, calls kernels of it, and returns how many it compiled, by package."""
    copy = tmp_path / "hybridworldsim"
    shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))

    def compile_again(edited: str | None = None) -> dict[str, int]:
        if edited is not None:
            file = copy / edited
            file.write_text(file.read_text() + "\n# edited\n")
        counts: dict[str, int] = json.loads(run(CALL_KERNELS.format(folder=str(tmp_path))))
        return counts

    return compile_again


def test_a_change_of_a_source_file_compiles_the_kernels_that_may_contain_it_again(
    compiled: Callable[..., dict[str, int]],
) -> None:
    every = {"rasterizer": 1, "model": 1}
    assert compiled() == every
    # The rasterizer's kernel comes from the cache.
    assert compiled("model/decoders.py") == {"rasterizer": 0, "model": 1}
    assert compiled("kernels/simd.py") == every
    assert compiled("rasterizer/presets.py") == every


def test_importing_the_rasterizer_and_its_kernels_reads_fewer_than_200_files(run: Run) -> None:
    assert 0 < int(run(COUNT_FILES)) < 200
