"""``run.json``: everything that determines the result of a run; a folder belongs to the run that began in it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from mirror.errors import UsageError
from mirror.schema.documents import Document
from mirror.schema.files import TEMPORARY, read_json, write_json

RUN: Final = "run.json"


def begin_run(path: Path, run: Document, *, finished: bool, untrained: bool) -> None:
    """Write a run's document, or require that it equals the earlier one, unless the earlier run learned nothing.

    Args:
        path: folder of the run.
        run: the document, with a field `threads`.
        finished: whether the earlier run is finished; then its number of threads does not matter.
        untrained: whether the earlier run has saved nothing.

    Raises:
        UsageError: the folder holds another run or other files.
        DatasetError: the folder is not writable.
    """
    if not (path / RUN).exists():
        if is_occupied(path):
            raise UsageError("not empty, and not the folder of a run", file=path, remedy="name a new folder")
        write_json(path / RUN, run)
        return
    if not untrained:
        require_same_run(path, type(run), run.model_dump(mode="json"), finished=finished)


def require_same_run(path: Path, kind: type[Document], stated: Mapping[str, Any], *, finished: bool) -> None:
    """Require that the run of a folder has the stated values.

    Args:
        path: folder of the run.
        kind: type of its document.
        stated: values of the document as JSON, with `threads`; others are not compared.
        finished: whether the run is finished; then its number of threads does not matter.

    Raises:
        UsageError: a value differs.
    """
    before = read_json(path / RUN, kind).model_dump(mode="json")
    compared = {key: before[key] for key in stated}
    differing = _differing(compared, {**stated, "threads": before["threads"]} if finished else stated)
    if differing:
        elsewhere = "name another folder with --out"
        same = before["threads"] == stated["threads"]
        raise UsageError(
            f"a run of other settings began here: {'; '.join(differing[:4])}", file=path,
            expected="the same dataset, method and settings",
            remedy=elsewhere if same or finished else f"--threads {before['threads']}, or {elsewhere}",
        )  # fmt: skip


def is_occupied(path: Path) -> bool:
    """Return whether a path is a file, or a folder that holds more than temporary files of a killed process."""
    if not path.is_dir():
        return path.exists()
    return any(not (entry.name.startswith(".") and entry.name.endswith(TEMPORARY)) for entry in path.iterdir())


def _differing(before: Mapping[str, Any], current: Mapping[str, Any], under: str = "") -> list[str]:
    """The differences of two documents, in words."""
    differences = []
    for key in before.keys() | current.keys():
        old, new = before.get(key), current.get(key)
        if isinstance(old, dict) and isinstance(new, dict):
            differences += _differing(old, new, f"{under}{key}.")
        elif old != new:
            differences.append(f"{under}{key} {_short(old)}, now {_short(new)}")
    return sorted(differences)


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
