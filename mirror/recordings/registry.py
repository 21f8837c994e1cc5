"""Finds the installed readers, and opens a recording with the one that recognises it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final, cast

from mirror.errors import RecordingError
from mirror.plugins import PluginKind, is_file_reference
from mirror.recordings.paths import not_a_file_error
from mirror.recordings.protocol import ENTRY_POINT_GROUP, CollectionReader, Reader, Recording

READERS: Final = PluginKind("reader", ENTRY_POINT_GROUP, "--reader", "all", error=RecordingError)


def load_readers(name: str | None = None) -> dict[str, Reader]:
    """Load readers by name, in the order of names: MIRROR's own and readers of other installed packages.

    Args:
        name: load only this reader, so that broken packages with other readers do no harm; ``FILE.py:CLASS``: load
            this class; None: load all installed readers.

    Raises:
        RecordingError: there is no such reader, two packages use one name, or an entry point gives no reader of its
            name.
    """
    if name is not None and is_file_reference(name):
        return {name: _make_reader(READERS.load(name), name)}
    names = READERS.names() if name is None else [name]
    return {one: _make_installed_reader(one) for one in names}


def _make_reader(found: Callable[[], object], name: str) -> Reader:
    READERS.require_call(found, name, name.rpartition(":")[2], ())
    reader = found()
    READERS.require_parts(reader, name, Reader)
    return cast(Reader, reader)


def _make_installed_reader(name: str) -> Reader:
    reader = READERS.load(name)()
    if not isinstance(reader, Reader) or reader.name != name:
        raise RecordingError(
            f"{READERS.find(name).value} is not a reader named {name!r}",
            place=f"entry-point group {ENTRY_POINT_GROUP}",
            expected="a class that follows mirror.recordings.protocol.Reader",
            remedy="repair or uninstall the package that declares it, or name the reader you want: --reader",
        )
    return reader


def open_recording(path: str | Path, reader: str | None = None, options: Mapping[str, str] | None = None) -> Recording:
    """Open a recording with a named reader, or with the reader that recognises the recording.

    Args:
        path: a file or folder, or ``FOLDER/NAME`` for a drive of a folder that holds several.
        reader: name of a reader; None: the one that recognises the path.
        options: options of that reader.

    Raises:
        RecordingError: the path does not exist, no reader or several readers recognise it, or the reader refuses it.
    """
    return find_reader(path, reader).open(Path(path), options or {})


def find_reader(path: str | Path, reader: str | None = None) -> Reader:
    """Find the reader of a recording.

    Args:
        path: as in `open_recording`.
        reader: name of a reader; None: the one that recognises the path.

    Raises:
        RecordingError: the path does not exist, or no reader or several readers recognise it.
    """
    path = Path(path)
    if not path.exists() and not is_drive_of_folder(path, reader):
        raise RecordingError("there is no file or folder at this path", file=path, expected="a recording")
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise not_a_file_error(path)
    known = load_readers(reader)
    if reader is not None:
        return known[reader]
    holder = path if path.exists() else path.parent
    matching = [name for name, candidate in known.items() if candidate.recognises(holder)]
    if len(matching) > 1:
        raise RecordingError(
            f"several readers recognise it: {' and '.join(matching)}",
            file=path,
            expected="; ".join(f"{name}: {known[name].expects}" for name in matching),
            remedy=f"name the reader: --reader {' or '.join(matching)}",
        )
    if not matching and (path / "dataset.json").is_file():
        raise RecordingError(
            "a MIRROR dataset, not a recording",
            file=path,
            expected="a recording",
            remedy="name the recordings that it was made from, or describe it: mirror info DATASET",
        )
    if not matching and path.is_dir() and not any(path.iterdir()):
        raise RecordingError(
            "the folder is empty",
            file=path,
            expected="a recording, or a folder of recordings",
            remedy="copy the recording again, or name another one",
        )
    if not matching:
        raise RecordingError(
            "no reader recognises this path",
            file=path,
            expected=f"a recording of one of the formats {', '.join(sorted(known))}",
            remedy="check the path, or name the format, so that its reader says what is missing: --reader NAME",
        )
    return known[matching[0]]


def is_drive_of_folder(path: Path, reader: str | None = None) -> bool:
    """Return whether a path that does not exist may name a drive of the folder above it.

    Args:
        path: the path.
        reader: name of a reader; None: any.
    """
    readers = load_readers(reader).values()
    return path.parent.is_dir() and any(
        isinstance(candidate, CollectionReader) and candidate.recognises(path.parent) for candidate in readers
    )


def list_drives(path: Path, reader: str | None = None) -> list[Path] | None:
    """Return the paths of the drives of a folder that may hold several; None if no reader recognises such a folder.

    A folder with one drive is its path.

    Raises:
        RecordingError: the folder's tables cannot be read.
    """
    for candidate in load_readers(reader).values():
        if isinstance(candidate, CollectionReader) and candidate.recognises(path):
            names = candidate.drives(path)
            return [path / name for name in names] if len(names) > 1 else [path]
    return None


_FLAGS: Final = {"tz": "--tz", "columns": "--columns"}
"""Options of readers that have a flag of their own on the command line."""


def refuse_options(options: Mapping[str, str], known: tuple[str, ...], path: Path, reader: str) -> None:
    """Refuse options that a reader does not have.

    Args:
        options: the given options.
        known: names of the reader's options.
        path: the recording, for the message.
        reader: name of the reader, for the message.

    Raises:
        RecordingError: an option is unknown.
    """
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise RecordingError(
            f"the reader {reader!r} has no option {_FLAGS.get(unknown[0], f'--option {unknown[0]}=VALUE')}",
            file=path,
            expected=f"one of {', '.join(known)}" if known else "no options for this reader",
            remedy="name one of them" if known else "leave the option out",
        )
