"""The pytest plug-in of runs with mutants: records tests, or runs the likeliest first and ends those that hang.

The environment variable MIRROR_MUTANTS names a JSON file: ``{"record": file}`` or ``{"order": [test], "limit_s": {test:
seconds}}``.
"""

from __future__ import annotations

import faulthandler
import json
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any, Final

import pytest

_PLAN: Final[dict[str, Any]] = json.loads(Path(os.environ["MIRROR_MUTANTS"]).read_bytes())
_HERE: Final = f"{Path.cwd()}/"
_NEW_TEST_S: Final = 120.0


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the likeliest tests first."""
    rank = {test: index for index, test in enumerate(_PLAN.get("order", ()))}
    items.sort(key=lambda item: rank.get(item.nodeid, len(rank)))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Record a test, or end the run if the test takes too long."""
    return (yield from _run_recorded(item) if "record" in _PLAN else _run_limited(item))


def _run_limited(item: pytest.Item) -> Iterator[None]:
    # Runs in its own thread, which compiled code does not block.
    faulthandler.dump_traceback_later(_PLAN["limit_s"].get(item.nodeid, _NEW_TEST_S), exit=True)
    try:
        return (yield)
    finally:
        faulthandler.cancel_dump_traceback_later()


def _run_recorded(item: pytest.Item) -> Iterator[None]:
    called: set[tuple[str, int]] = set()

    def record_call(frame: FrameType, event: str, argument: object) -> None:
        if event == "call":
            called.add((frame.f_code.co_filename, frame.f_code.co_firstlineno))

    begin = time.perf_counter()
    sys.setprofile(record_call)
    try:
        return (yield)
    finally:
        sys.setprofile(None)
        calls = sorted(f"{file.removeprefix(_HERE)}:{line}" for file, line in called if file.startswith(_HERE))
        with Path(_PLAN["record"]).open("a") as out:
            out.write(json.dumps({"test": item.nodeid, "s": time.perf_counter() - begin, "calls": calls}) + "\n")
