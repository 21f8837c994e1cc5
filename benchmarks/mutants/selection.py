"""Which tests can notice a change of a function, and which of them are likely to."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from benchmarks.mutants.recorder import is_compiled

_FAR: Final = 1_000
_UNRELATED: Final = 6
_FILES: Final = 4


@dataclass(frozen=True)
class RecordedTest:
    """A test of the clean run.

    Attributes:
        name: pytest's name of it.
        cpu_s: processor time, without that of fixtures of the module or the session.
        fixtures: processor time of each such fixture that it uses.
        starts: it starts processes, whose calls are not recorded.
        calls: ``FILE:LINE`` of the first line of each function that it calls, or its fixtures do.
    """

    name: str
    cpu_s: float
    fixtures: Mapping[str, float]
    starts: bool
    calls: frozenset[str]

    @property
    def file(self) -> str:
        """Path of the test's file in the tree."""
        return self.name.partition("::")[0]

    @classmethod
    def of(cls, line: Mapping[str, Any]) -> RecordedTest:
        """Return a test of a line that the plug-in writes."""
        return cls(line["test"], line["s"], line["fixtures"], line["starts"], frozenset(line["calls"]))


def select_tests(
    tests: Sequence[RecordedTest],
    changed: str,
    function: int,
    distances: Mapping[str, int],
    *,
    compiled: bool,
    at_import: Container[str] = (),
) -> list[RecordedTest]:
    """Return the tests that can notice a change of a file, the likeliest first.

    These are all tests of the files with a test that calls the function; if there is none, or if the function is also
    called where modules are imported, of the files with a test that calls the changed file or one that imports it, or
    that imports it themselves. The others that start processes follow, and where functions of the changed file may be
    compiled, all that call a file that imports it.

    Args:
        tests: of the clean run.
        changed: path of the changed file.
        function: first line of the changed function; 0: the change lies outside of functions.
        distances: number of imports between the changed file and each file that imports it, as of `count_imports`.
        compiled: whether functions of the changed file may be compiled.
        at_import: functions that are called where modules are imported.
    """
    name = f"{changed}:{function}"
    near = {test.name: _nearest(test, distances) for test in tests}
    callers = {test.file for test in tests if name in test.calls}
    touching = {test.file for test in tests if near[test.name] < _FAR or test.file in distances}
    files = callers if function and callers and name not in at_import else touching
    chosen = [
        test
        for test in tests
        if test.file in files or test.starts or (compiled and (near[test.name] < _FAR or test.file in distances))
    ]

    def unlikely(test: RecordedTest) -> tuple[bool, bool, int, int, float]:
        nearest = near[test.name]
        return name not in test.calls, test.file not in files, nearest, -_shared(test.file, changed), test.cpu_s

    return sorted(chosen, key=unlikely)


def likeliest_files(files: Iterable[str], changed: str, distances: Mapping[str, int]) -> list[str]:
    """Return the few test files whose names and imports are nearest to a changed file, the nearest first.

    Args:
        files: paths of the test files of the changed file's room.
        changed: path of the changed file.
        distances: number of imports between the changed file and each file that imports it, as of `count_imports`.
    """

    def score(file: str) -> tuple[int, str]:
        return min(distances.get(file, _UNRELATED), _UNRELATED) - _shared(file, changed), file

    return sorted(files, key=score)[:_FILES]


def count_imports(changed: str, importers: Mapping[str, Iterable[str]]) -> dict[str, int]:
    """Return the number of imports between a file and each that imports it, directly or indirectly; 0 for itself."""
    found, fresh, steps = {changed: 0}, [changed], 0
    while fresh:
        steps += 1
        fresh = sorted({one for file in fresh for one in importers.get(file, ())} - set(found))
        found |= dict.fromkeys(fresh, steps)
    return found


def find_importers(texts: Mapping[str, str]) -> dict[str, set[str]]:
    """Return for each file the files that import it, of the texts of Python files.

    Names of modules in strings count as imports, as of ``"package.module:function"`` in a registry.
    """
    files = {_module(file): file for file in texts}
    importers: dict[str, set[str]] = defaultdict(set)
    for file, text in texts.items():
        for node in ast.walk(ast.parse(text)):
            for module in _imported(node):
                if module in files and files[module] != file:
                    importers[files[module]].add(file)
    return importers


def may_change_kernels(text: str, function: int, *, at_import: bool) -> bool:
    """Return whether a change of a file can change machine code: of a compiled function, or of a value at import."""
    return is_compiled(text) or not function or at_import


def _imported(node: ast.AST) -> list[str]:
    if isinstance(node, ast.ImportFrom) and node.module and not node.level:
        return [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if isinstance(node, ast.Constant) and isinstance(node.value, str) and "." in node.value:
        return [node.value.partition(":")[0]]
    return []


def _nearest(test: RecordedTest, distances: Mapping[str, int]) -> int:
    return min((distances.get(call.rpartition(":")[0], _FAR) for call in test.calls), default=_FAR)


def _shared(test: str, changed: str) -> int:
    """Return how many words the paths of a test and of a changed file have in common."""
    return len(_words(test) & _words(changed))


def _words(path: str) -> set[str]:
    return set(path.removesuffix(".py").replace("_", "/").split("/")) - {"test", "tests", "mirror"}


def _module(file: str) -> str:
    bare = file.removeprefix("baselines/").removeprefix("leaderboard/")
    return bare.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
