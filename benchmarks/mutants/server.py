"""Runs pytest in forked children of one process that has imported the libraries, which do not change between mutants.

The imports of libraries take two thirds of the processor time of a short run. This file is run as a script: the process
imports neither the tree under test nor anything of `benchmarks`. It reads requests from standard input, one JSON object
a line, and answers each with one line: ``{"code": exit code, "cpu_s": processor time of the child and of what it
started}``.
"""

from __future__ import annotations

import gc
import importlib
import json
import os
import resource
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

_LIBRARIES: Final = (
    "pytest", "hypothesis", "hypothesis.strategies", "hypothesis.extra.numpy", "numpy", "numba", "llvmlite.binding",
    "pandas", "pyarrow", "pyarrow.parquet", "pyarrow.dataset", "pyarrow.compute", "cv2", "scipy.spatial",
    "scipy.optimize", "scipy.special", "scipy.ndimage", "shapely", "shapely.geometry", "pyproj", "pydantic",
    "tyro", "fsspec", "rich.progress", "rich.table", "jinja2", "torch", "skimage.metrics",
)  # fmt: skip
_MEMORY_BYTES: Final = 3 * 2**33
_POLL_S: Final = 0.02
_IDLE_S: Final = 120.0


def main() -> int:
    """Answer requests until standard input ends."""
    for name in _LIBRARIES:
        # A test that needs a library that is not installed says so itself.
        with suppress(ImportError):
            importlib.import_module(name)
    gc.collect()
    gc.freeze()
    for line in sys.stdin:
        print(json.dumps(run(json.loads(line))), flush=True)
    return 0


def run(request: dict[str, Any]) -> dict[str, Any]:
    """Run pytest once: its ``words``, in the folder ``tree``, with ``environment``, until it ends or waits forever."""
    child = os.fork()
    if child == 0:
        _become_pytest(request)
    computed_s, looked = 0.0, time.monotonic()
    while True:
        ended, status, used = os.wait4(child, os.WNOHANG)
        if ended:
            break
        # However busy the machine is, a process that has work gets some processor time.
        if time.monotonic() - looked > _IDLE_S:
            before, computed_s, looked = computed_s, session_s(child), time.monotonic()
            if computed_s == before:
                _kill(child)
        time.sleep(_POLL_S)
    # Processes that the tests left behind.
    _kill(child)
    return {"code": os.waitstatus_to_exitcode(status), "cpu_s": used.ru_utime + used.ru_stime}


def session_s(session: int) -> float:
    """Return the processor time of the processes of a session that still run, and of those that they waited for."""
    ticks = 0
    for file in Path("/proc").glob("[0-9]*/stat"):
        # A process may end meanwhile.
        with suppress(OSError):
            # The name, in parentheses, may hold anything.
            words = file.read_text().rpartition(")")[2].split()
            if int(words[3]) == session:
                ticks += sum(map(int, words[11:15]))
    return ticks / os.sysconf("SC_CLK_TCK")


def _kill(group: int) -> None:
    with suppress(ProcessLookupError):
        os.killpg(group, signal.SIGKILL)


def _become_pytest(request: dict[str, Any]) -> None:
    code = 3
    try:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
        output = os.open(request["output"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        null = os.open(os.devnull, os.O_RDONLY)
        for file, number in ((null, 0), (output, 1), (output, 2)):
            os.dup2(file, number)
        os.chdir(request["tree"])
        os.environ.update(request["environment"])
        # The folder of this script is no place to import from.
        sys.path[:1] = request["environment"]["PYTHONPATH"].split(os.pathsep)
        import pytest

        code = int(pytest.main(request["words"]))
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


if __name__ == "__main__":
    sys.exit(main())
