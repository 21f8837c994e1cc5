"""The pytest plug-in of runs with mutants: records tests, or runs those of a plan and ends those that hang.

The environment variable MIRROR_MUTANTS names a JSON file. ``{"record": file}`` records. ``{"order": [test], "limit_s":
{test: processor time}}`` runs some tests. ``{"files": [test file], "without": [test], "limit_s": processor time of a
test, "budget_s": processor time after which no test begins}`` runs all but some tests of some files.
"""

from __future__ import annotations

import json
import math
import multiprocessing.process
import os
import resource
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import pytest

from benchmarks.mutants.recorder import start_recording

_PLAN: Final[dict[str, Any]] = json.loads(Path(os.environ["MIRROR_MUTANTS"]).read_bytes())
_PACKAGES: Final = ("mirror", "hybridworldsim", "mirror_baselines")
_STARTS: Final = ("subprocess.Popen", "os.fork", "os.forkpty", "os.posix_spawn", "os.exec", "os.system")


def pytest_configure(config: pytest.Config) -> None:
    """Register the part that records, or the part that follows a plan."""
    config.pluginmanager.register(_RECORDER or (_Follower() if "order" in _PLAN else _Sampler()))


class _Follower:
    """Runs the tests of the plan, and no others, in its order."""

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        rank = {test: index for index, test in enumerate(_PLAN["order"])}
        items[:] = sorted((item for item in items if item.nodeid in rank), key=lambda item: rank[item.nodeid])

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        _limit(_PLAN["limit_s"][item.nodeid])
        return (yield)


class _Sampler:
    """Runs the tests of some files, one file after the other, until they have taken their processor time."""

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        rank = {file: index for index, file in enumerate(_PLAN["files"])}
        without = set(_PLAN["without"])
        known = [item for item in items if item.nodeid not in without]
        items[:] = sorted(known, key=lambda item: rank[item.nodeid.partition("::")[0]])

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> bool | None:
        if _cpu_s() > _PLAN["budget_s"]:
            return True
        _limit(_PLAN["limit_s"])
        return None


def _limit(limit_s: float) -> None:
    """Let the operating system end this process when it has used more processor time, also within compiled code."""
    soft = math.ceil(time.process_time() + limit_s)
    resource.setrlimit(resource.RLIMIT_CPU, (soft, resource.getrlimit(resource.RLIMIT_CPU)[1]))


class _Recorder:
    """Records a test's processor time, the functions it calls, whether it starts processes, and whether it fails.

    What a fixture of a module or of the session calls counts for every test that uses it.
    """

    def __init__(self, file: Path) -> None:
        self._file = file
        self._called: set[str] = set()
        self._forget = start_recording(Path.cwd(), _PACKAGES, self._called)
        self._imports: list[str] | None = None
        self._fixture_calls: dict[str, set[str]] = defaultdict(set)
        self._fixture_s: dict[str, float] = defaultdict(float)
        self._starts = False
        self._fixture_starts: set[str] = set()
        self._failed: set[str] = set()
        self._path: Path | None = None
        sys.addaudithook(self._note_event)
        start = multiprocessing.process.BaseProcess.start

        def noted(process: multiprocessing.process.BaseProcess) -> None:
            self._starts = True
            start(process)

        setattr(multiprocessing.process.BaseProcess, "start", noted)  # noqa: B010 - mypy refuses the assignment

    def _note_event(self, event: str, _: object) -> None:
        self._starts = self._starts or event in _STARTS

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[Any]) -> Iterator[None]:
        if fixturedef.scope == "function":
            return (yield)
        before, begin, others = set(self._called), _cpu_s(), sum(self._fixture_s.values())
        self._called.clear()
        started, self._starts = self._starts, False
        try:
            return (yield)
        finally:
            name = fixturedef.argname
            self._fixture_calls[name] |= self._called
            # Fixtures that this one asks for while it runs have noted their own time.
            self._fixture_s[name] += _cpu_s() - begin - (sum(self._fixture_s.values()) - others)
            self._called |= before
            if self._starts:
                self._fixture_starts.add(name)
            self._starts |= started

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self._failed.add(report.nodeid)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Iterator[None]:
        if self._imports is None:
            self._imports = sorted(self._called)
        if item.path != self._path:
            self._forget()
            self._path = item.path
        self._called.clear()
        self._starts = False
        begin, fixtures = _cpu_s(), sum(self._fixture_s.values())
        try:
            return (yield)
        finally:
            used = [name for name in getattr(item, "fixturenames", ()) if name in self._fixture_s]
            calls = self._called.union(*(self._fixture_calls[name] for name in used))
            one = {
                "test": item.nodeid,
                "s": round(_cpu_s() - begin - (sum(self._fixture_s.values()) - fixtures), 3),
                "fixtures": {name: round(self._fixture_s[name], 3) for name in used},
                "starts": self._starts or not self._fixture_starts.isdisjoint(used),
                "failed": item.nodeid in self._failed,
                "calls": sorted(calls),
            }
            one["imports"], self._imports = self._imports, []
            with self._file.open("a") as out:
                out.write(json.dumps(one) + "\n")


def _cpu_s() -> float:
    """Return the processor time of this process and of those that it started and waited for."""
    return sum(os.times()[:4])


# Modules that are imported before the first test, by a `conftest.py`, are recorded too.
_RECORDER: Final = _Recorder(Path(_PLAN["record"])) if "record" in _PLAN else None
