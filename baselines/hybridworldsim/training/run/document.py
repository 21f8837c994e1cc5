"""``run.json``: everything that determines the result of a run; a folder belongs to the run that began in it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from mirror.devices import CPU, OPTION, library_versions
from mirror.errors import UsageError
from mirror.schema.documents import Document
from mirror.schema.files import TEMPORARY, read_json, write_json

RUN: Final = "run.json"

_COMPUTED: Final = "computed"


class Computation(Document):
    """Device, precision and libraries of a run; results of the CPU and of GPUs differ in the last digits.

    Attributes:
        device: where it was begun, as torch names it.
        precision: of the computation.
        versions: versions of the libraries, and the name of a GPU.
    """

    device: str
    precision: str
    versions: dict[str, str]


def describe_computation(device: str, precision: str = "float32", *, splats: bool = False) -> Computation:
    """Describe the device, precision and libraries of a run; see `mirror.devices.library_versions`."""
    return Computation(device=device, precision=precision, versions=library_versions(device, splats=splats))


def begin_run(path: Path, run: Document, *, finished: bool, untrained: bool) -> None:
    """Write a run's document, or require that it equals an earlier run's, unless that run learned nothing.

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
    begun, now = (_kind_of_device(one.get(_COMPUTED)) for one in (before, stated))
    stated = {key: value for key, value in stated.items() if key != _COMPUTED}
    compared = {key: before[key] for key in stated}
    differing = _differing(compared, {**stated, "threads": before["threads"]} if finished else stated)
    if begun != now and not finished:
        differing.append(f"device {begun}, now {now}")
    if differing:
        elsewhere = "name another folder with --out"
        threads = "" if finished or before["threads"] == stated["threads"] else f"--threads {before['threads']}"
        device = "" if finished or begun == now else f"{OPTION} {begun}"
        options = " ".join(filter(None, (threads, device)))
        raise UsageError(
            f"a run of other settings began here: {'; '.join(differing[:4])}", file=path,
            expected="the same dataset, method and settings",
            remedy=f"{options}, or {elsewhere}" if options else elsewhere,
        )  # fmt: skip


def is_occupied(path: Path) -> bool:
    """Return whether a path is a file, or a folder that holds more than temporary files of a killed process."""
    if not path.is_dir():
        return path.exists()
    return any(not (entry.name.startswith(".") and entry.name.endswith(TEMPORARY)) for entry in path.iterdir())


def _kind_of_device(computed: Mapping[str, Any] | None) -> str:
    """``cpu`` or ``cuda``; runs that state nothing were made on the CPU."""
    return CPU if computed is None else str(computed["device"]).partition(":")[0]


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
