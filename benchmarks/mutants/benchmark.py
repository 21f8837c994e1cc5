"""Changes single tokens in the source, runs the tests against each change, and lists the changes that no test detects.

``python -m benchmarks mutants`` runs those of 300 mutants that have no outcome yet, and prints the survivors.
``benchmarks/mutants/equivalent.toml`` lists the survivors that are equivalent to the source, each with its reason. The
exit code is 1 if a survivor has no reason, if less than 90 % are killed, or if some have not run.

The name of a mutant is three lines: the line before, the line, and the changed line. Outcomes
(``benchmarks/mutants/outcomes.jsonl``) and reasons are stored under names, so that lines that move to another place or
file keep theirs. ``--fresh`` ignores the stored outcomes. The names of the sample stand in
``benchmarks/mutants/sample.txt``, one a line, so that new code does not change it. Mutants whose line the source no
longer has count as gone; ``--draw`` replaces the sample by the mutants of the present source with the least hashes.

Nothing runs in the checkout: the tracked files and the real recordings (of MIRROR_REAL_DATA) are copied once, and every
mutant gets a tree of hard links to this copy, in which the changed file is another one. First the test files run whose
names and imports are nearest to the mutant, as long as ``--first-s`` allows; a kill counts where the same test passes
without the mutant. What survives them meets all tests of its area that can notice the change (`selection.py`): a clean
run, once for each area, records which functions each test calls. Compiled kernels are removed from a tree if their
module imports the changed one, directly or indirectly, and the change can reach compiled code. All limits are in
processor time.

Expected for 300 mutants: one and a half core-hours. Measured: 3.9 s a mutant for the nearest files (2.2 s where one of
them kills it), of 89; clean runs of all areas take about ten minutes, and a survivor a minute.
"""

from __future__ import annotations

import argparse
import compileall
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from queue import SimpleQueue
from threading import Lock
from typing import Any, Final, TypeVar

from benchmarks.mutants.mutations import Mutant, compiles, mutant_name, mutants
from benchmarks.mutants.selection import (
    RecordedTest,
    count_imports,
    find_importers,
    likeliest_files,
    may_change_kernels,
    select_tests,
)
from benchmarks.mutants.trees import forget_kernels, link_tree, read_stamps, replace_file
from benchmarks.report import OUT
from mirror.errors import ExitCode
from mirror.schema.json_lines import append_line, decode_object, read_lines

_One = TypeVar("_One")
ROOT: Final = Path(__file__).resolve().parents[2]
ROOMS: Final = {
    "mirror/geometry": ("tests/geometry",),
    "mirror/metrics": ("tests/metrics",),
    "mirror/ingest": ("tests/ingest",),
    "mirror/recordings": ("tests/recordings",),
    "mirror/schema": ("tests/schema",),
    "mirror/dataset": ("tests/dataset",),
    "mirror/integrity": ("tests/integrity",),
    "mirror/protocols": ("tests/protocols", "tests/evaluation"),
    "mirror/methods": ("tests/methods", "tests/evaluation"),
    "mirror/evaluation": ("tests/evaluation",),
    "baselines/hybridworldsim/kernels": ("tests/kernels", "tests/rasterizer"),
    "baselines/hybridworldsim/rasterizer": ("tests/rasterizer",),
}
_EQUIVALENT: Final = Path(__file__).parent / "equivalent.toml"
_OUTCOMES: Final = Path(__file__).parent / "outcomes.jsonl"
_SAMPLE: Final = Path(__file__).parent / "sample.txt"
_BAR: Final = 0.9
# A test may take ten times as long as without a mutant, plus the first time; plus the second where kernels compile.
_PATIENCE_S: Final = 10.0
_COMPILING_S: Final = 90.0
_FIRST_LIMIT_S: Final = 120.0
# Tests of speed fail on a busy machine.
_WORDS: Final = ("-q", "-p", "no:cacheprovider", "-p", "no:randomly", "-p", "no:xdist", "--hypothesis-seed=0",
                 "-p", "benchmarks.mutants.plugin", "-k", "not fast_enough")  # fmt: skip
# Exit codes of pytest.
_PASSED, _FAILED, _INTERRUPTED, _USAGE, _NO_TESTS = 0, 1, 2, 4, 5


def main(argv: list[str] | None = None) -> int:
    """Run the mutants of the sample, and report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="replace the sample by one of the present source")
    parser.add_argument("--count", type=int, default=300, help="of --draw")
    parser.add_argument("--seed", type=int, default=0, help="of --draw")
    parser.add_argument("--hours", type=float, default=4.0, help="processor time after which no new mutant is begun")
    parser.add_argument("--first-s", type=float, default=20.0, help="processor time of the likeliest tests of a mutant")
    parser.add_argument("--workers", type=int, default=1, help="mutants that run at once, each on a core")
    parser.add_argument("--state", type=Path, default=OUT / "mutants", help="folder of the copies of the tree")
    parser.add_argument("--rooms", nargs="+", choices=list(ROOMS), default=list(ROOMS), help="whose mutants run")
    parser.add_argument("--first-only", action="store_true", help="do not run the rest against what survives")
    parser.add_argument("--fresh", action="store_true", help="delete the stored outcomes and run all mutants")
    parser.add_argument("--again", action="store_true", help="run the survivors without a reason once more")
    parser.add_argument("--report", action="store_true", help="run nothing")
    options = parser.parse_args(argv)
    if options.draw:
        names = [mutant.name for mutant in draw(all_mutants(), options.count, options.seed)]
        _SAMPLE.write_text("".join(f"{name}\n" for name in names))
    sample = _SAMPLE.read_text().splitlines()
    present = find(sample, all_mutants())
    if options.fresh:
        _OUTCOMES.unlink(missing_ok=True)
    outcomes = {one["mutant"]: one for one in read_lines(_OUTCOMES, decode_object)}
    reasons = {reason_name(one): one["because"] for one in read_reasons()}
    if not options.report:
        wanted = [one for one in present if _room(one.file) in options.rooms]
        again = {name for name, one in outcomes.items() if not one["killed"] and name not in reasons}
        fresh = [one for one in wanted if one.name not in outcomes or (options.again and one.name in again)]
        run = _Run(options.state.resolve(), outcomes, options.workers, options.first_s)
        try:
            run.begin()
            run.try_mutants(fresh, options.hours, rest=False)
            for room in () if options.first_only else options.rooms:
                begun = [one for one in wanted if not outcomes.get(one.name, {"complete": True})["complete"]]
                survivors = [one for one in begun if _room(one.file) == room]
                if survivors:
                    run.record(room)
                    run.try_mutants(survivors, options.hours, rest=True)
        finally:
            run.end()
    return _report(present, len(sample) - len(present), outcomes, reasons)


def all_mutants() -> list[Mutant]:
    """Return the mutants of all rooms; of equal names, that of the first file."""
    files = sorted({path.relative_to(ROOT).as_posix() for room in ROOMS for path in (ROOT / room).rglob("*.py")})
    found: dict[str, Mutant] = {}
    for file in files:
        for mutant in mutants(file, (ROOT / file).read_text()):
            found.setdefault(mutant.name, mutant)
    return list(found.values())


def draw(every: Sequence[Mutant], count: int, seed: int) -> list[Mutant]:
    """Return the mutants with the smallest hashes, without those that are not Python."""
    ranked = sorted(every, key=lambda mutant: hashlib.sha256(f"{seed} {mutant.name}".encode()).digest())
    valid = (mutant for mutant in ranked if compiles(mutant.applied((ROOT / mutant.file).read_text())))
    return list(islice(valid, count))


def find(names: Iterable[str], every: Iterable[Mutant]) -> list[Mutant]:
    """Return the mutants with these names that the source still has, in the order of the names."""
    by_name = {mutant.name: mutant for mutant in every}
    return [by_name[name] for name in names if name in by_name]


class _Worker:
    """One tree in which mutants run, one after the other, and the process that forks their tests."""

    def __init__(self, state: Path, number: int) -> None:
        self.tree = state / f"work{number}"
        self.files = state / f"files{number}"
        self._server: subprocess.Popen[str] | None = None

    def run(self, tree: Path, words: Sequence[str], plan: Mapping[str, Any]) -> tuple[int, float, str]:
        """Run pytest in a tree; return its exit code, its processor time, and what it printed."""
        shutil.rmtree(self.files, ignore_errors=True)
        (self.files / "tmp").mkdir(parents=True)
        (self.files / "plan.json").write_text(json.dumps(plan))
        environment = {
            "PYTHONPATH": os.pathsep.join(map(str, (tree, tree / "baselines", tree / "leaderboard"))),
            "MIRROR_MUTANTS": str(self.files / "plan.json"),
            "MIRROR_REAL_DATA": str(tree / "real_data"),
            "HYPOTHESIS_PROFILE": "whole",
            "HYPOTHESIS_STORAGE_DIRECTORY": str(self.files / "hypothesis"),
            "TMPDIR": str(self.files / "tmp"),
        }
        output = self.files / "output.txt"
        request = {"tree": str(tree), "environment": environment, "output": str(output), "words": [*_WORDS, *words]}
        self._server = self._server or _start_server()
        if self._server.stdin is None or self._server.stdout is None:
            raise RuntimeError("the server of pytest has no pipes")
        print(json.dumps(request), file=self._server.stdin, flush=True)
        answer = json.loads(self._server.stdout.readline())
        return answer["code"], answer["cpu_s"], output.read_text(errors="replace")

    def end(self) -> None:
        """End the process."""
        if self._server is not None:
            self._server.communicate()


class _Run:
    """The copy of the tree, the record of its tests, and the outcomes of mutants."""

    def __init__(self, state: Path, outcomes: dict[str, Any], workers: int, first_s: float) -> None:
        self._state, self._clean, self._record = state, state / "clean", state / "tests.json"
        self._outcomes, self._first_s = outcomes, first_s
        self._free: SimpleQueue[_Worker] = SimpleQueue()
        for number in range(workers):
            self._free.put(_Worker(state, number))
        self._lock = Lock()
        self._texts: dict[str, str] = {}
        self._tests: dict[str, list[RecordedTest]] = {}
        self._at_import: set[str] = set()
        # Tests, or test files, that pass without a mutant, and tests that do not.
        self._passing: set[str] = set()
        self._failing: set[str] = set()

    def hours(self) -> float:
        """Return the processor time that all outcomes took."""
        return float(sum(one["cpu_s"] for one in self._outcomes.values())) / 3600

    def begin(self) -> None:
        """Copy the tree."""
        words = ("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard")
        listed = subprocess.run(words, cwd=ROOT, check=True, capture_output=True, text=True).stdout.split("\0")
        files = {name: (ROOT / name).read_bytes() for name in listed if name and (ROOT / name).is_file()}
        self._texts = {name: data.decode() for name, data in files.items() if name.endswith(".py")}
        self._importers = find_importers(self._texts)
        self._copy(files)
        self._stamps = read_stamps(self._clean)

    def record(self, room: str) -> None:
        """Run the tests of a room that have changed, or whose source has, since they were last recorded."""
        recorded = json.loads(self._record.read_bytes()) if self._record.exists() else {}

        def record_folder(folder: str) -> None:
            found = [name for name in self._texts if name.startswith(f"{folder}/") and "/test_" in name]
            stale = [name for name in found if not self._is_current(name, recorded.get(name))]
            fresh = self._run_clean(stale) if stale else {}
            with self._lock:
                recorded.update(fresh)
                self._record.write_text(json.dumps(recorded))
                lines = [line for name in found for line in recorded[name]["tests"]]
                self._tests[folder] = [RecordedTest.of(line) for line in lines if not line["failed"]]
                self._at_import.update(call for line in lines for call in line["imports"])

        self._each(record_folder, [folder for folder in ROOMS[room] if folder not in self._tests])

    def _each(self, do: Callable[[_One], None], some: Iterable[_One]) -> None:
        """Call a function with each item, on as many threads as there are workers."""
        with ThreadPoolExecutor(self._free.qsize()) as pool:
            list(pool.map(do, some))

    def end(self) -> None:
        """End the workers' processes."""
        while not self._free.empty():
            self._free.get().end()

    @contextmanager
    def _worker(self) -> Iterator[_Worker]:
        worker = self._free.get()
        try:
            yield worker
        finally:
            self._free.put(worker)

    def _copy(self, files: Mapping[str, bytes]) -> None:
        """Update the copy; unchanged files keep their compiled kernels."""
        self._clean.mkdir(parents=True, exist_ok=True)
        old = {path.relative_to(self._clean).as_posix(): path for path in self._clean.rglob("*") if path.is_file()}
        for name, path in old.items():
            if not name.startswith("real_data/") and "__pycache__" not in name and files.get(name) != path.read_bytes():
                path.unlink()
        changed = [name for name in files if not (self._clean / name).exists()]
        for name in changed:
            (self._clean / name).parent.mkdir(parents=True, exist_ok=True)
            (self._clean / name).write_bytes(files[name])
        for name in changed if old else ():
            for importer in count_imports(name, self._importers):
                forget_kernels(self._clean / importer)
        for room in ("mirror", "baselines"):
            compileall.compile_dir(self._clean / room, quiet=1)
        data = Path(os.environ.get("MIRROR_REAL_DATA", ROOT.parent / "shared" / "data"))
        if data.is_dir() and not (self._clean / "real_data").exists():
            shutil.copytree(data, self._clean / "real_data", copy_function=shutil.copy)

    def _is_current(self, file: str, record: Mapping[str, Any] | None) -> bool:
        return record is not None and record["digest"] == self._digest(file, record["used"])

    def _digest(self, file: str, used: Iterable[str]) -> str:
        """Return a hash of a test file, of shared test code, and of the source files that its tests call."""
        shared = [name for name in self._texts if name.startswith("tests/") and "/test_" not in name]
        names = sorted({file, *shared, *used})
        return hashlib.sha256("".join(name + self._texts.get(name, "") for name in names).encode()).hexdigest()

    def _run_clean(self, files: Sequence[str]) -> dict[str, Any]:
        """Return the records of some test files' tests, of a run without a mutant."""
        lines = self._record_tests(files)
        for line in lines:
            # A test of a busy machine fails now and then; one that fails twice is left out.
            if line["failed"]:
                line["failed"] = any(one["failed"] for one in self._record_tests([line["test"]]))
                print("FAILS   " if line["failed"] else "failed once", "without a mutant:", line["test"], flush=True)
        found = {}
        for file in files:
            own = [line for line in lines if line["test"].partition("::")[0] == file]
            used = sorted({call.rpartition(":")[0] for line in own for call in line["calls"]})
            found[file] = {"digest": self._digest(file, used), "used": used, "tests": own}
        return found

    def _record_tests(self, tests: Sequence[str]) -> list[dict[str, Any]]:
        with self._worker() as worker:
            out = worker.files / "recorded.jsonl"
            code, cpu_s, output = worker.run(self._clean, tests, {"record": str(out)})
            lines = list(read_lines(out, decode_object))
        if code not in (_PASSED, _FAILED, _NO_TESTS):
            raise RuntimeError(f"pytest ends with {code} without a mutant:\n{output[-3000:]}")
        print(f"recorded {len(lines)} tests of {len(tests)} files, {cpu_s:.0f} s", flush=True)
        return lines

    def try_mutants(self, some: Sequence[Mutant], hours: float, *, rest: bool) -> None:
        """Run the likeliest tests, or the rest, against mutants, until the outcomes together took some hours."""

        def attempt(mutant: Mutant) -> None:
            if self.hours() < hours:
                with self._worker() as worker:
                    (self._try_rest if rest else self._try_first)(worker, mutant)

        self._each(attempt, some)

    def _try_first(self, worker: _Worker, mutant: Mutant) -> None:
        """Run the test files whose names and imports are nearest to the mutant, within the processor time for them."""
        folders = tuple(f"{folder}/" for folder in ROOMS[_room(mutant.file)])
        tests = (name for name in self._texts if name.startswith(folders) and "/test_" in name)
        kernels = may_change_kernels(self._texts[mutant.file], mutant.function, at_import=False)
        more_s = _COMPILING_S * kernels
        files = likeliest_files(tests, mutant.file, count_imports(mutant.file, self._importers))
        spent_s = 0.0
        while True:
            self._make_tree(worker, mutant, kernels=kernels)
            plan = {"files": files, "without": sorted(self._failing), "limit_s": _FIRST_LIMIT_S + more_s}
            plan["budget_s"] = self._first_s + more_s
            code, cpu_s, output = self._run_tests(worker, worker.tree, files, plan)
            spent_s += cpu_s
            if code in (_PASSED, _NO_TESTS) or self._passes_clean(worker, _culprit(output, code), files, plan):
                killed = code not in (_PASSED, _NO_TESTS)
                self._store(mutant, code if killed else 0, spent_s, output, complete=killed)
                return

    def _passes_clean(self, worker: _Worker, culprit: str, files: Sequence[str], plan: Mapping[str, Any]) -> bool:
        """Return whether the test that fails with a mutant passes without; one that fails is left out from now on."""
        name = culprit.partition(" ")[2].partition(" - ")[0]
        if culprit in self._passing or name in self._passing:
            return True
        if "::" in name:
            clean: Mapping[str, Any] = {"order": [name], "limit_s": {name: _COMPILING_S}}
        elif name.startswith("tests/"):
            clean = {"order": [], "limit_s": {}}
        else:
            # A signal has ended the run.
            clean, name = plan, f"{culprit} {files}"
        asked = [name.partition("::")[0]] if name.startswith("tests/") else files
        code, _, _ = self._run_tests(worker, self._clean, asked, clean)
        if code in (_PASSED, _NO_TESTS):
            self._passing.add(name)
            return True
        print("FAILS    without a mutant:", name, flush=True)
        if "::" not in name:
            raise RuntimeError(f"{name} fails without a mutant")
        self._failing.add(name)
        return False

    def _try_rest(self, worker: _Worker, mutant: Mutant) -> None:
        """Run all tests that can notice the mutant."""
        known = [test for folder in ROOMS[_room(mutant.file)] for test in self._tests[folder]]
        at_import = f"{mutant.file}:{mutant.function}" in self._at_import
        kernels = may_change_kernels(self._texts[mutant.file], mutant.function, at_import=at_import)
        distances = count_imports(mutant.file, self._importers)
        able = select_tests(known, mutant.file, mutant.function, distances, compiled=kernels, at_import=self._at_import)
        tests = [test for test in able if test.name not in self._failing]
        code, cpu_s, output = 0, 0.0, ""
        if tests:
            self._make_tree(worker, mutant, kernels=kernels)
            patience_s = _PATIENCE_S + _COMPILING_S * kernels
            limits = {test.name: patience_s + 10 * (test.cpu_s + sum(test.fixtures.values())) for test in tests}
            plan = {"order": [test.name for test in tests], "limit_s": limits}
            files = list(dict.fromkeys(test.file for test in tests))
            code, cpu_s, output = self._run_tests(worker, worker.tree, files, plan)
        self._store(mutant, code, cpu_s, output, complete=True)

    def _make_tree(self, worker: _Worker, mutant: Mutant, *, kernels: bool) -> None:
        link_tree(self._clean, worker.tree)
        replace_file(worker.tree / mutant.file, mutant.applied(self._texts[mutant.file]))
        for importer in count_imports(mutant.file, self._importers) if kernels else ():
            forget_kernels(worker.tree / importer)

    def _run_tests(
        self, worker: _Worker, tree: Path, files: Sequence[str], plan: Mapping[str, Any]
    ) -> tuple[int, float, str]:
        code, cpu_s, output = worker.run(tree, ["-x", *files], plan)
        # A mutant that breaks the import of shared fixtures; anything else of these codes is a fault of this program.
        imports = code == _USAGE and "while loading conftest" in output
        if code not in (_PASSED, _FAILED, _INTERRUPTED, _NO_TESTS) and code > 0 and not imports:
            raise RuntimeError(f"pytest ends with {code}:\n{output[-3000:]}")
        if read_stamps(self._clean) != self._stamps:
            raise RuntimeError(f"{self._clean} is not as it was: a test wrote through a link; delete the folder")
        return code, cpu_s, output

    def _store(self, mutant: Mutant, code: int, cpu_s: float, output: str, *, complete: bool) -> None:
        with self._lock:
            before = self._outcomes.get(mutant.name, {"cpu_s": 0.0})["cpu_s"]
            outcome = {"mutant": mutant.name, "file": mutant.file, "killed": code != 0, "complete": complete}
            outcome |= {"cpu_s": round(before + cpu_s, 1), "by": _culprit(output, code)[:200] if code else None}
            self._outcomes[mutant.name] = outcome
            append_line(_OUTCOMES, json.dumps(outcome))
        state = "killed  " if code else "SURVIVED" if complete else "so far survived"
        print(state, f"{cpu_s:.1f} s", mutant.file, mutant.name, flush=True)


def _culprit(output: str, code: int) -> str:
    """Return the line of pytest's summary that names the first failure, or the exit code."""
    return next((line for line in output.splitlines() if line.startswith(("FAILED ", "ERROR "))), f"exit {code}")


def _room(file: str) -> str:
    return next(room for room in ROOMS if file.startswith(f"{room}/"))


def _start_server() -> subprocess.Popen[str]:
    # Without bytecode every run would compile all sources.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    command = [sys.executable, str(Path(__file__).with_name("server.py"))]
    pipe = subprocess.PIPE
    return subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, env=environment, cwd="/")


def read_reasons() -> list[dict[str, Any]]:
    """Read the mutants that are equivalent to the source, each with its reason."""
    found: list[dict[str, Any]] = tomllib.loads(_EQUIVALENT.read_text())["equivalent"]
    return found


def reason_name(reason: Mapping[str, Any]) -> str:
    """Return the name of the mutant that a reason explains."""
    return mutant_name(reason["after"], reason["line"], reason["becomes"], reason.get("repeat", 0))


def _report(
    present: Iterable[Mutant], gone: int, outcomes: Mapping[str, Mapping[str, Any]], reasons: Mapping[str, str]
) -> int:
    counts: dict[str, Counter[str]] = {room: Counter() for room in (*ROOMS, "all")}
    for mutant in present:
        outcome = outcomes.get(mutant.name)
        if outcome is None or not (outcome["killed"] or outcome["complete"]):
            state = "not run"
        else:
            state = "killed" if outcome["killed"] else "survived"
        if state == "survived" and mutant.name in reasons:
            state = "equivalent"
        elif state != "killed":
            print(f"{state:8} {mutant.file}:{mutant.row}: {mutant.name}")
        for room in counts:
            if room == "all" or mutant.file.startswith(f"{room}/"):
                counts[room][state] += 1
    print("\n| room | mutants | killed | equivalent | survived | not run |\n|---|---|---|---|---|---|")
    for room, count in counts.items():
        figures = (count[state] for state in ("killed", "equivalent", "survived", "not run"))
        print(f"| {room} | {count.total()} | {' | '.join(map(str, figures))} |")
    every = counts["all"]
    share = every["killed"] / max(every.total(), 1)
    print(f"\nkilled: {share:.1%}, {_BAR:.0%} asked for; gone: {gone}")
    return (
        ExitCode.DONE if share >= _BAR and every["killed"] + every["equivalent"] == every.total() else ExitCode.FINDINGS
    )


if __name__ == "__main__":
    sys.exit(main())
