"""The remedy of an error that states only what is expected: where the user writes it.

Most errors say the whole cure in `expected` ("a number from 0 to 1"). What they cannot know is how the value reached
them: by which option, or in which file. The command line knows.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from mirror.errors import DatasetError, MirrorError, SchemaError

_OPTION: Final = re.compile(r"--[a-z][a-z0-9-]*")
_READER_OPTION: Final = re.compile(r"option ([a-z_]+)")
_ARGUMENT: Final = re.compile(r"[A-Z]{4,}")
_QUOTED: Final = re.compile(r"'([^']+)'")
_NO_OPTION: Final = "no such option"
_DATASET: Final = "dataset.json"


def complete_remedy(error: MirrorError, command: str, words: Sequence[str] = ()) -> None:
    """Add a remedy to an error without one: an option, a place in a file, or the help of the command.

    Args:
        error: as it was raised.
        command: as it is typed, such as ``mirror calibrate check``.
        words: the words after it.
    """
    if error.remedy is None:
        error.remedy = _remedy(error, error.command or command, words)


def _remedy(error: MirrorError, command: str, words: Sequence[str]) -> str:
    stated = _OPTION.match(error.place or "") or _ARGUMENT.fullmatch(error.place or "")
    option = stated[0] if stated else _option_with_value(error, words)
    if option is not None:
        if (error.expected or "").startswith(_NO_OPTION):
            return f"leave out {option}"
        return f"give {option} as expected" if error.expected else f"give another {option}"
    if of_reader := _READER_OPTION.fullmatch(error.place or ""):
        return f"give --option {of_reader[1]}=VALUE as expected"
    if error.file is None:
        place = f"{error.place}: " if error.place else ""
        return f"{place}`{command} --help` explains what it takes"
    path = Path(error.file)
    option = _option_with_path(path, words)
    another = "name another one" + (f" with {option}" if option else "")
    if not path.exists():
        return f"make it first, or {another}"
    root = _dataset_of(path) if isinstance(error, DatasetError | SchemaError) else None
    if root is not None:
        return f"`mirror check {root}` lists what is damaged in the dataset"
    if path.is_dir():
        return another
    return f"correct {error.place or 'the file'}{' in the file' if error.place else ''}, or {another}"


def _options(words: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the options of a command line with their values."""
    for word, following in zip(words, [*words[1:], ""]):
        option, equals, value = word.partition("=")
        if _OPTION.fullmatch(option):
            yield option, value if equals else following


def _option_with_value(error: MirrorError, words: Sequence[str]) -> str | None:
    """Return the option whose value is what the message quotes, such as a name that is unknown."""
    if error.file is not None or error.place is not None:
        return None
    quoted = set(_QUOTED.findall(error.problem))
    return next((option for option, value in _options(words) if value in quoted), None)


def _option_with_path(path: Path, words: Sequence[str]) -> str | None:
    """Return the option whose value is a path, or a folder that the path is in."""
    for option, value in _options(words):
        if Path(value).name and path.absolute().is_relative_to(Path(value).absolute()):
            return option
    return None


def _dataset_of(path: Path) -> Path | None:
    """Return the dataset that a file belongs to."""
    return next((folder for folder in path.parents if (folder / _DATASET).is_file()), None)
