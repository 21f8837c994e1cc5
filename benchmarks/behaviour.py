"""Records names, types and hashes of what the toolkit writes, to compare two revisions.

``python -m benchmarks behaviour --out before.json``, and after a refactoring ``--against before.json``. Times, free
text and versions are left out. The model and scores depend on the processor and on the versions of torch and numpy, so
both runs must use one machine.
"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import tyro

from mirror.errors import ExitCode, UsageError

_LEFT_OUT: Final = frozenset(
    {"version", "versions", "description", "notes", "note", "reason", "interval_reason", "unavailable", "warnings"}
    | {"frames_per_second"}
)
_HASHED: Final = frozenset({".parquet", ".jpg", ".png", ".npy"})
"""Tables and images. Documents are left out, because a recording's fingerprint depends on the times of its files."""
_STEPS: Final = 40


@dataclass(frozen=True)
class Arguments:
    """Record what the toolkit writes, or compare it with an earlier record."""

    out: Path | None = None
    """File to write the record to."""
    against: Path | None = None
    """An earlier record; exit code 1 where anything differs."""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    arguments = tyro.cli(Arguments, args=list(argv), prog="python -m benchmarks behaviour")
    if arguments.out is None and arguments.against is None:
        raise UsageError("neither --out nor --against is given", expected="one of them, or both")
    with tempfile.TemporaryDirectory() as folder:
        record = {"rules": _rules(), "tables": _tables(), **_files(Path(folder))}
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(record, indent=1) + "\n")
        print(arguments.out)
    if arguments.against is None:
        return ExitCode.DONE
    differences = list(_differences(json.loads(arguments.against.read_text()), json.loads(json.dumps(record)), ""))
    print("\n".join(differences) or "nothing differs")
    return ExitCode.FINDINGS if differences else ExitCode.DONE


def _rules() -> list[list[str]]:
    """Ids, severities and costs of the integrity rules, in order."""
    from mirror.integrity.registry import rules

    return [[rule.rule_id, str(rule.severity), rule.cost.name] for rule in rules().values()]


def _tables() -> dict[str, list[str]]:
    """Names and types of the columns of every table."""
    from mirror.schema import index_tables, tables

    names = {**vars(tables), **vars(index_tables)}
    own = [value for value in names.values() if isinstance(value, tables.Table)]
    return {table.name: [f"{field.name}: {field.type}" for field in table.schema] for table in own}


def _files(folder: Path) -> dict[str, Any]:
    """Hashes of the files that the verbs write, from recordings to a model."""
    recordings, dataset, floor = folder / "recordings", folder / "dataset", folder / "floor"
    _run("synth", "--preset", "quick", "--out", recordings)
    _run("ingest", *sorted(recordings.glob("*-*")), "--rois", recordings / "rois.geojson", "--out", dataset)
    _run("split", dataset, "novel")
    _run("check", dataset)
    _run("baseline", dataset, "--method", "nearest_frame", "--split", "novel", "--out", floor)
    _run("evaluate", dataset, floor, "--out", folder / "scores")
    before = _hashes(dataset)
    training = ["--steps", _STEPS, "--width", 96, "--threads", 1, "--device", "cpu", "--initialise", "plane-sweep"]
    _run("reconstruct", dataset, "--split", "novel", *training, "--out", folder / "model")
    return {
        "dataset": before,
        "layers": {name: digest for name, digest in _hashes(dataset).items() if name not in before},
        "floor": _hashes(floor),
        "result": _without_text(json.loads((folder / "scores" / "result.json").read_text())),
        "model": {name: one for name, one in _hashes(folder / "model").items() if name.endswith(".safetensors")},
    }


def _run(*words: object) -> None:
    subprocess.run([sys.executable, "-m", "mirror.cli.main", *map(str, words)], check=True, stdout=subprocess.DEVNULL)


def _hashes(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.suffix in _HASHED or path.name == "model.safetensors")
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def _without_text(value: Any) -> Any:
    """A document without its free text and times."""
    if isinstance(value, dict):
        kept = {key: one for key, one in value.items() if key not in _LEFT_OUT and not key.endswith(("_s", "_ms"))}
        return {key: _without_text(one) for key, one in kept.items()}
    return [_without_text(one) for one in value] if isinstance(value, list) else value


def _differences(before: Any, after: Any, place: str) -> Iterator[str]:
    if isinstance(before, dict) and isinstance(after, dict):
        for key in sorted({*before, *after}):
            yield from _differences(before.get(key), after.get(key), f"{place}/{key}")
    elif isinstance(before, list) and isinstance(after, list) and len(before) == len(after):
        for number, (one, other) in enumerate(zip(before, after)):
            yield from _differences(one, other, f"{place}/{number}")
    elif before != after:
        yield f"{place}: {before} -> {after}"
