"""Changes single tokens in the source, runs the tests against each change, and lists the changes that no test detects.

``python -m benchmarks mutants`` runs those of 300 mutants that have no outcome yet, and prints the survivors.
``benchmarks/mutants/equivalent.toml`` lists the survivors that are equivalent to the source, each with its reason. The
exit code is 1 if a survivor has no reason, if less than 85 % are killed, or if some have not run.

The name of a mutant is three lines: the line before, the line, and the changed line. Outcomes
(``benchmarks/mutants/outcomes.jsonl``) and reasons are stored under names, so that lines that move to another place or
file keep theirs. ``--fresh`` ignores the stored outcomes. The names of the sample stand in
``benchmarks/mutants/sample.txt``, one a line, so that new code does not change it. Mutants whose line the source no
longer has count as gone; ``--draw`` replaces the sample by the mutants of the present source with the least hashes.

Nothing runs in the checkout: every mutant gets a fresh copy of the tracked files and of the real recordings (of
MIRROR_REAL_DATA). First the tests run without a mutant and must pass; this run records how long each test takes and
which functions it calls, so that the tests most likely to fail run first. Compiled kernels are removed from the copy if
their module imports the changed one, directly or indirectly.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any, Final

from benchmarks.mutants.mutations import Mutant, compiles, mutant_name, mutants
from benchmarks.report import OUT
from mirror.errors import ExitCode
from mirror.schema.json_lines import append_line, decode_object, read_lines

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
_BAR: Final = 0.85
# A test may take ten times as long as without a mutant, plus this time for compiling kernels.
_PATIENCE_S: Final = 120.0
_ROOM_S: Final = 1800.0
_MEMORY_BYTES: Final = 3 * 2**33
# Tests of speed fail on a busy machine.
_TESTS: Final = ("-x", "-q", "-p", "no:cacheprovider", "-p", "no:randomly", "-p", "benchmarks.mutants.plugin",
                 "--hypothesis-seed=0", "-k", "not fast_enough")  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    """Run the mutants of the sample, and report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draw", action="store_true", help="replace the sample by one of the present source")
    parser.add_argument("--count", type=int, default=300, help="of --draw")
    parser.add_argument("--seed", type=int, default=0, help="of --draw")
    parser.add_argument("--hours", type=float, default=4.0, help="processor time after which no new mutant is begun")
    parser.add_argument("--state", type=Path, default=OUT / "mutants", help="folder of the copies of the tree")
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
    run = _Run(options.state.resolve())
    reasons = {reason_name(one): one["because"] for one in read_reasons()}
    if not options.report:
        run.begin()
        for mutant in present:
            outcome = run.outcomes.get(mutant.name)
            survived = options.again and outcome is not None and not outcome["killed"] and mutant.name not in reasons
            if (outcome is None or survived) and run.hours() < options.hours:
                run.try_mutant(mutant)
    return _report(present, len(sample) - len(present), run.outcomes, reasons)


def all_mutants() -> list[Mutant]:
    """Return the mutants of all rooms; of equal names, that of the first file."""
    files = sorted({path.relative_to(ROOT).as_posix() for room in ROOMS for path in _sources(ROOT / room)})
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


class _Run:
    """The copies in which mutants run, and their outcomes."""

    def __init__(self, state: Path) -> None:
        self.clean, self.work = state / "clean", state / "work"
        self._state, self._record = state, state / "tests.json"
        self.outcomes = {one["mutant"]: one for one in read_lines(_OUTCOMES, decode_object)}
        self._tests: dict[str, list[dict[str, Any]]] = {}

    def hours(self) -> float:
        """Processor time that all outcomes took."""
        return float(sum(one["cpu_s"] for one in self.outcomes.values())) / 3600

    def begin(self) -> None:
        """Copy the tree, and run the tests of rooms that have changed since their last recorded run."""
        words = ("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard")
        listed = subprocess.run(words, cwd=ROOT, check=True, capture_output=True, text=True).stdout.split("\0")
        texts = {name: (ROOT / name).read_bytes() for name in listed if name and (ROOT / name).is_file()}
        self._copy(texts)
        recorded = json.loads(self._record.read_bytes()) if self._record.exists() else {}
        for room in ROOMS:
            # Rooms with the same tests have the same hash.
            digest = _digest(texts, room)
            if digest not in recorded:
                lines = self._state / "recorded.jsonl"
                lines.unlink(missing_ok=True)
                code, output = self._pytest(self.clean, room, {"record": str(lines)})
                if code:
                    print(
                        f"the tests of {room} fail without a mutant, so that its mutants do not run:\n{output[-3000:]}"
                    )
                    continue
                tests = [json.loads(line) for line in lines.read_text().splitlines()]
                recorded[digest] = tests
                self._record.write_text(json.dumps(recorded))
            self._tests[room] = recorded[digest]

    def _copy(self, texts: Mapping[str, bytes]) -> None:
        """Update the copy; unchanged files keep their compiled kernels."""
        self.clean.mkdir(parents=True, exist_ok=True)
        old = {path.relative_to(self.clean).as_posix(): path for path in self.clean.rglob("*") if path.is_file()}
        for name, path in old.items():
            if not name.startswith("real_data/") and "__pycache__" not in name and texts.get(name) != path.read_bytes():
                path.unlink()
        changed = [name for name in texts if not (self.clean / name).exists()]
        for name in changed:
            (self.clean / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, self.clean / name)
        for name in changed if old else ():
            for importer in _importers(name, self.clean):
                _forget_kernels(self.clean / importer)
        data = Path(os.environ.get("MIRROR_REAL_DATA", ROOT.parent / "shared" / "data"))
        if data.is_dir() and not (self.clean / "real_data").exists():
            shutil.copytree(data, self.clean / "real_data", copy_function=shutil.copy)

    def try_mutant(self, mutant: Mutant) -> None:
        """Run a room's tests against a mutant and store the outcome, if the tests pass without it."""
        room = next(room for room in ROOMS if mutant.file.startswith(f"{room}/"))
        if room not in self._tests:
            return
        shutil.rmtree(self.work, ignore_errors=True)
        shutil.copytree(self.clean, self.work, symlinks=True)
        file = self.work / mutant.file
        file.write_text(mutant.applied(file.read_text()))
        importers = _importers(mutant.file, self.work)
        for importer in importers:
            _forget_kernels(self.work / importer)
        function = f"{mutant.file}:{mutant.function}"

        def unlikely(test: Mapping[str, Any]) -> tuple[bool, bool, bool, float]:
            files = {call.rpartition(":")[0] for call in test["calls"]}
            return function not in test["calls"], mutant.file not in files, not files & importers, test["s"]

        tests = self._tests[room]
        limits = {test["test"]: _PATIENCE_S + 10 * test["s"] for test in tests}
        plan = {"order": [test["test"] for test in sorted(tests, key=unlikely)], "limit_s": limits}
        begin = _cpu_s()
        code, output = self._pytest(self.work, room, plan)
        by = next((line for line in output.splitlines() if line.startswith(("FAILED", "ERROR"))), f"exit {code}")
        outcome = {"mutant": mutant.name, "file": mutant.file, "killed": code != 0, "cpu_s": round(_cpu_s() - begin, 1)}
        outcome |= {"by": by[:200] if code else None}
        self.outcomes[mutant.name] = outcome
        append_line(_OUTCOMES, json.dumps(outcome))
        print("killed  " if code else "SURVIVED", mutant.file, mutant.name, flush=True)

    def _pytest(self, tree: Path, room: str, plan: Mapping[str, Any]) -> tuple[int, str]:
        file = self._state / "plan.json"
        file.write_text(json.dumps(plan))
        temporary = self._state / "tmp"
        shutil.rmtree(temporary, ignore_errors=True)
        temporary.mkdir()
        environment = os.environ | {
            "PYTHONPATH": f"{tree}:{tree}/baselines:{tree}/leaderboard",
            "MIRROR_MUTANTS": str(file),
            "MIRROR_REAL_DATA": str(tree / "real_data"),
            "TMPDIR": str(temporary),
        }
        words = [sys.executable, "-m", "pytest", *_TESTS, *ROOMS[room]]
        with (self._state / "output.txt").open("w+") as output:
            process = subprocess.Popen(
                words,
                cwd=tree,
                env=environment,
                stdout=output,
                stderr=output,
                start_new_session=True,
                preexec_fn=_bound,
            )
            try:
                code = process.wait(_ROOM_S)
            except subprocess.TimeoutExpired:
                code = -signal.SIGKILL
            finally:
                _end(process)
            output.seek(0)
            return code, output.read()


def _end(process: subprocess.Popen[bytes]) -> None:
    """Kill the remaining processes of a run."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def _bound() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))


def _cpu_s() -> float:
    """Processor time of all runs so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _sources(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.py"))


def _importers(file: str, tree: Path) -> set[str]:
    """A source file and all files of the rooms that import it, directly or indirectly."""
    texts = {path.relative_to(tree).as_posix(): path.read_text() for room in ROOMS for path in _sources(tree / room)}
    found, fresh = {file}, {file}
    while fresh:
        modules = [_module(one) for one in fresh]
        named = {f"from {module} import" for module in modules}
        named |= {
            f"from {package} import {name}" for package, _, name in (module.rpartition(".") for module in modules)
        }
        fresh = {one for one, text in texts.items() if any(words in text for words in named)} - found
        found |= fresh
    return found


def _forget_kernels(file: Path) -> None:
    """Delete numba's compiled kernels of a source file."""
    for kernel in file.parent.glob(f"__pycache__/{file.stem}.*.nb[ic]"):
        kernel.unlink()


def _digest(texts: Mapping[str, bytes], room: str) -> str:
    """A hash of the source, of shared test code, and of the room's own tests."""
    own = tuple(f"{folder}/" for folder in ("mirror", "baselines", *ROOMS[room]))
    used = [
        name for name in sorted(texts) if name.startswith(own) or (name.startswith("tests/") and "/test_" not in name)
    ]
    return hashlib.sha256(b"".join(name.encode() + texts[name] for name in used)).hexdigest()


def _module(file: str) -> str:
    return file.removeprefix("baselines/").removesuffix(".py").removesuffix("/__init__").replace("/", ".")


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
        state = "not run" if outcome is None else "killed" if outcome["killed"] else "survived"
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
