"""Which tokens are changed, their replacements and names; which tests run against a change, in which tree."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmarks.mutants.benchmark import ROOT, find, read_reasons, reason_name
from benchmarks.mutants.mutations import compiles, mutants
from benchmarks.mutants.selection import (
    RecordedTest,
    count_imports,
    find_importers,
    likeliest_files,
    may_change_kernels,
    select_tests,
)
from benchmarks.mutants.server import session_s
from benchmarks.mutants.trees import link_tree, read_stamps, replace_file

SOURCE = '''
@cached(size=7)
def first(a: Annotated[int, Field(ge=0)], *rest: int, **more: int | None) -> bool:
    """Take 1 and + another."""
    for one in rest:
        if a not in rest and a < 2:
            raise ValueError(f"{a} - 3")
    log.debug("%d", 4)
    return not call(*rest, a * 0.5, key=a is not None)  # 6
'''


def test_operators_numbers_and_logic_change_and_text_does_not() -> None:
    found = [mutant for mutant in mutants("a.py", SOURCE) if compiles(mutant.applied(SOURCE))]
    assert [(mutant.row, mutant.becomes) for mutant in found] == [
        (3, "def first(a: Annotated[int, Field(ge=1)], *rest: int, **more: int | None) -> bool:"),
        (6, "if a in rest and a < 2:"),
        (6, "if a not in rest or a < 2:"),
        (6, "if a not in rest and a <= 2:"),
        (6, "if a not in rest and a > 2:"),
        (6, "if a not in rest and a < 3:"),
        (9, "return call(*rest, a * 0.5, key=a is not None)  # 6"),
        (9, "return not call(*rest, a + 0.5, key=a is not None)  # 6"),
        (9, "return not call(*rest, a / 0.5, key=a is not None)  # 6"),
        (9, "return not call(*rest, a * 1.5, key=a is not None)  # 6"),
        (9, "return not call(*rest, a * 0.5, key=a is None)  # 6"),
    ]
    # The first line of the function is that of its decorator, as in its code object.
    assert {mutant.function for mutant in found} == {2}


def test_only_the_changed_line_differs() -> None:
    for mutant in mutants("a.py", SOURCE):
        before, after = SOURCE.splitlines(), mutant.applied(SOURCE).splitlines()
        assert [row for row, pair in enumerate(zip(before, after, strict=True), 1) if pair[0] != pair[1]] == [
            mutant.row
        ]


def test_a_mutant_keeps_its_name_where_its_lines_move() -> None:
    names = [mutant.name for mutant in mutants("a.py", SOURCE)]
    assert [mutant.name for mutant in mutants("b.py", "import x\n\n# A note.\n" + SOURCE)] == names
    assert len(set(names)) == len(names)
    twice = [mutant.name for mutant in mutants("a.py", SOURCE + SOURCE)]
    assert len(set(twice)) == len(twice)


def test_the_sample_is_found_by_name_and_new_code_does_not_change_it() -> None:
    names = [mutant.name for mutant in mutants("a.py", SOURCE)]
    sample = [names[4], names[0]]
    present = list(mutants("b.py", "def other(c: int) -> int:\n    return c + 1\n" + SOURCE))
    assert [mutant.name for mutant in find(sample, present)] == sample
    gone = list(mutants("b.py", SOURCE.replace("Field(ge=0)", "Field()")))
    assert [mutant.name for mutant in find(sample, gone)] == sample[:1]


def test_every_reason_is_that_of_a_mutant_of_the_present_source() -> None:
    for reason in read_reasons():
        file = reason["file"]
        assert reason_name(reason) in {mutant.name for mutant in mutants(file, (ROOT / file).read_text())}, file


def recorded(name: str, *calls: str, s: float = 1.0, starts: bool = False, **fixtures: float) -> RecordedTest:
    return RecordedTest(name, s, fixtures, starts, frozenset(calls))


TESTS = [
    recorded("tests/test_far.py::test_verb", starts=True),
    recorded("tests/test_user.py::test_user", "mirror/user.py:1"),
    recorded("tests/test_own.py::test_other", "mirror/own.py:20"),
    recorded("tests/test_own.py::test_slow", "mirror/own.py:10", s=9.0),
    recorded("tests/test_own.py::test_quick", "mirror/own.py:10"),
    recorded("tests/test_none.py::test_none", "mirror/none.py:1"),
]
DISTANCES = {"mirror/own.py": 0, "mirror/user.py": 1}


def select(function: int, *, compiled: bool = False, at_import: tuple[str, ...] = ()) -> list[str]:
    tests = select_tests(TESTS, "mirror/own.py", function, DISTANCES, compiled=compiled, at_import=at_import)
    return [test.name.partition("::")[2] for test in tests]


def test_the_files_of_tests_that_call_a_function_run_and_the_likeliest_tests_first() -> None:
    assert select(10) == ["test_quick", "test_slow", "test_other", "test_verb"]


def test_a_line_outside_of_functions_or_a_function_that_no_test_calls_is_tested_by_importers() -> None:
    assert select(0) == select(30) == ["test_other", "test_quick", "test_slow", "test_user", "test_verb"]
    # What a function returns while modules are imported, other tests see too.
    assert select(10, at_import=("mirror/own.py:10",)) == [
        "test_quick",
        "test_slow",
        "test_other",
        "test_user",
        "test_verb",
    ]


def test_importers_of_a_file_that_may_be_compiled_run_after_the_callers() -> None:
    assert select(10, compiled=True) == ["test_quick", "test_slow", "test_other", "test_user", "test_verb"]


def test_the_likeliest_files_are_nearest_by_name_and_by_imports() -> None:
    files = ["tests/ingest/test_run.py", "tests/metrics/boxes/test_areas.py", "tests/metrics/boxes/test_iou.py"]
    files += [f"tests/metrics/test_{number}.py" for number in range(9)]
    distances = {"mirror/metrics/boxes/iou.py": 0, "tests/metrics/boxes/test_areas.py": 1, "tests/metrics/test_3.py": 1}
    found = likeliest_files(files, "mirror/metrics/boxes/iou.py", distances)
    assert found[:3] == [
        "tests/metrics/boxes/test_areas.py",
        "tests/metrics/test_3.py",
        "tests/metrics/boxes/test_iou.py",
    ]
    assert len(found) == 4


def test_importers_are_direct_and_indirect_named_in_strings_or_through_a_package() -> None:
    texts = {
        "mirror/low.py": "",
        "mirror/room/__init__.py": "from mirror.low import (\n    one,\n    two,\n)",
        "mirror/room/inner.py": "from mirror import other, low",
        "mirror/table.py": 'READERS = {"low": "mirror.low:Reader"}',
        "baselines/hybridworldsim/user.py": "def late():\n    from mirror.room import one",
        "tests/test_user.py": "import hybridworldsim.user",
        "mirror/other.py": "import numpy",
    }
    found = count_imports("mirror/low.py", find_importers(texts))
    assert found == {
        "mirror/low.py": 0,
        "mirror/room/__init__.py": 1,
        "mirror/room/inner.py": 1,
        "mirror/table.py": 1,
        "baselines/hybridworldsim/user.py": 2,
        "tests/test_user.py": 3,
    }


def test_kernels_stay_where_a_change_cannot_reach_compiled_code() -> None:
    assert may_change_kernels("from mirror.compiled import inner_njit", 3, at_import=False)
    assert may_change_kernels("SIZE = 3", 0, at_import=False)
    assert may_change_kernels("def size(): return 3", 1, at_import=True)
    assert not may_change_kernels("def size(): return 3", 1, at_import=False)


def test_a_changed_file_leaves_the_file_that_it_was_linked_to_as_it_is(tmp_path: Path) -> None:
    clean, work = tmp_path / "clean", tmp_path / "work"
    (clean / "mirror" / "__pycache__").mkdir(parents=True)
    (clean / "mirror" / "a.py").write_text("A = 1\n")
    (clean / "mirror" / "b.py").write_text("B = 1\n")
    (clean / "mirror" / "__pycache__" / "a.cpython-311.pyc").write_bytes(b"old")
    stamps = read_stamps(clean)
    link_tree(clean, work)
    replace_file(work / "mirror" / "a.py", "A = 2\n")
    assert (clean / "mirror" / "a.py").read_text() == "A = 1\n"
    assert (work / "mirror" / "a.py").read_text() == "A = 2\n"
    assert not list((work / "mirror").glob("__pycache__/a.*"))
    assert (work / "mirror" / "b.py").samefile(clean / "mirror" / "b.py")
    assert read_stamps(clean) == stamps
    # The next mutant's tree is whole again, without what tests left.
    (work / "mirror" / "left.txt").write_text("left")
    (work / ".hypothesis" / "examples").mkdir(parents=True)
    link_tree(clean, work)
    assert {path.name for path in work.rglob("*")} == {"mirror", "__pycache__", "a.cpython-311.pyc", "a.py", "b.py"}
    assert all(path.samefile(clean / path.relative_to(work)) for path in work.rglob("*.*"))
    assert read_stamps(clean) == stamps
    # A test that writes into a file of the tree is found out, also if it does so without a change of the size.
    (work / "mirror" / "b.py").write_text("B = 2\n")
    assert {name for name, stamp in read_stamps(clean).items() if stamp != stamps[name]} == {"mirror/b.py"}


MODULE = '''"""A module."""

import functools
import subprocess
import sys


def at_import() -> int:
    return 1


ONE = at_import()


@functools.cache
def kept() -> int:
    """Keep its docstring."""
    return inner()


def inner() -> int:
    return 2


def start() -> int:
    return subprocess.run([sys.executable, "-c", ""], check=False).returncode


def hang(value: int) -> None:
    while value:
        pass
'''
TEST_FILE = """import pytest
from mirror import a


@pytest.fixture(scope="module")
def two() -> int:
    return a.kept()


def test_fixture(two: int) -> None:
    assert two == 2 and a.kept.__doc__ == "Keep its docstring."


def test_same_fixture(two: int) -> None:
    assert two == 2


def test_process() -> None:
    assert a.start() == 0


def test_failure() -> None:
    assert a.ONE == 2


def test_hang() -> None:
    a.hang(0)
"""


def test_the_processor_time_of_a_session_counts_whoever_computes() -> None:
    code = "import os, sys; sys.stdin.read(1); sum(range(3_000_000)); os.write(1, b'x'); sys.stdin.read()"
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", code], stdin=pipe, stdout=pipe, start_new_session=True) as process:
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(b"go")
        process.stdin.flush()
        assert process.stdout.read(1) == b"x"
        # It waits: nothing is added.
        assert session_s(process.pid) == session_s(process.pid) > 0.0
        process.stdin.close()
    assert session_s(process.pid) == 0.0


def run_plugin(tree: Path, plan: dict[str, Any]) -> int:
    """Run pytest with the plug-in in a tree, and return its exit code."""
    (tree / "plan.json").write_text(json.dumps(plan))
    environment = os.environ | {"PYTHONPATH": f"{tree}:{ROOT}", "MIRROR_MUTANTS": str(tree / "plan.json")}
    words = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:xdist",
        "-p",
        "no:hypothesispytest",
    ]
    words += ["-p", "benchmarks.mutants.plugin", "--rootdir", str(tree), "tests"]
    return subprocess.run(words, cwd=tree, env=environment, check=False, capture_output=True).returncode


def test_the_plugin_records_calls_and_runs_a_plan_within_its_limits(tmp_path: Path) -> None:
    for folder in ("mirror", "tests"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "__init__.py").touch()
    (tmp_path / "mirror" / "a.py").write_text(MODULE)
    (tmp_path / "tests" / "test_a.py").write_text(TEST_FILE)
    # Two files, so that what is cached is called again in the second.
    (tmp_path / "tests" / "test_b.py").write_text(TEST_FILE)
    out = tmp_path / "recorded.jsonl"
    assert run_plugin(tmp_path, {"record": str(out)}) == 1
    lines = {line["test"]: line for line in map(json.loads, out.read_text().splitlines())}
    kept = ["mirror/a.py:15", "mirror/a.py:21"]
    for file in ("tests/test_a.py", "tests/test_b.py"):
        # The second test of a fixture uses what the first one's set up has called.
        assert lines[f"{file}::test_fixture"]["calls"] == lines[f"{file}::test_same_fixture"]["calls"] == kept
        assert lines[f"{file}::test_process"]["calls"] == ["mirror/a.py:25"]
        assert [line["test"] for line in lines.values() if line["starts"] and line["test"].startswith(file)] == [
            f"{file}::test_process"
        ]
    assert {name.partition("::")[2] for name, line in lines.items() if line["failed"]} == {"test_failure"}
    assert lines["tests/test_a.py::test_fixture"]["imports"] == ["mirror/a.py:8"]
    # The function's first line is that of its mutants.
    assert {mutant.function for mutant in mutants("mirror/a.py", MODULE)} <= {0, 8, 15, 21, 25, 29}

    def follow(*names: str) -> int:
        order = [f"tests/test_a.py::{name}" for name in names]
        return run_plugin(tmp_path, {"order": order, "limit_s": dict.fromkeys(order, 1.0)})

    assert follow("test_hang", "test_fixture") == 0
    assert follow("test_failure") == 1
    assert follow("test_gone") == 5

    def sample(budget_s: float, *without: str) -> int:
        files = ["tests/test_a.py", "tests/test_b.py"]
        left_out = [f"{file}::{name}" for file in files for name in without]
        return run_plugin(tmp_path, {"files": files, "without": left_out, "limit_s": 9.0, "budget_s": budget_s})

    assert sample(99.0) == 1
    assert sample(99.0, "test_failure") == 0
    # No test begins.
    assert sample(0.0) == 0
    replace_file(tmp_path / "mirror" / "a.py", MODULE.replace("while value", "while not value"))
    assert follow("test_hang") == -signal.SIGXCPU
