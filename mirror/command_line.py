"""The arguments of a verb: a frozen dataclass, whose fields are the options and whose docstrings are the help.

A field of type `Path` is a path on this machine: a URL in its place is refused here, for every verb. A field that also
takes a URL is of type `str`.
"""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass, replace
from pathlib import Path
from types import NoneType
from typing import Any, Final, NamedTuple, TypeVar, get_args

import tyro
from tyro.constructors import ConstructorRegistry, PrimitiveConstructorSpec, PrimitiveTypeInfo

from mirror.errors import ExitCode, MirrorError, UsageError

_Arguments = TypeVar("_Arguments")

_REGISTRY: Final = ConstructorRegistry()

_OUTPUTS: Final = ("out", "save", "video")
"""Fields that name what a verb writes; each that is a path of this machine is checked before the verb works."""

# `Path` turns two slashes into one. A URL scheme has at least two letters, a drive letter is one.
_URL: Final = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+):/|.*::")


class Subcommand(NamedTuple):
    """A command within a verb, such as `new` of ``mirror submission new``.

    Attributes:
        summary: one line for the verb's help.
        run: takes the words after the subcommand and returns the exit code.
    """

    summary: str
    run: Callable[[Sequence[str]], int]


def parse_arguments(
    kind: type[_Arguments],
    words: Sequence[str],
    command: str,
    *,
    examples: Sequence[str],
    renamed: Mapping[str, str] | None = None,
) -> _Arguments:
    """Parse the arguments of a command; for ``--help`` and wrong arguments, print a text and exit.

    Args:
        kind: the dataclass of the arguments.
        words: the words after the command.
        command: the command as it is typed, such as ``mirror check``.
        examples: command lines that the help ends with; they name the folders that ``mirror demo`` makes.
        renamed: old options that are still accepted, with their new names; see `apply_new_names`.

    Raises:
        UsageError: a URL stands where a path is expected, a number is not finite, or an output cannot be written.
        SystemExit: the help was printed (code 0), or the arguments are wrong (code 2).
    """
    words = apply_new_names(words, command, renamed or {})
    try:
        arguments = tyro.cli(
            kind, args=words, prog=command, config=(tyro.conf.PositionalMetavarFromFieldName,), registry=_REGISTRY
        )
    except SystemExit as ended:
        if not ended.code:
            print("\n".join(["examples, with the folders that `mirror demo` makes:", *(f"  {e}" for e in examples)]))
        raise
    refuse_urls(arguments)
    refuse_numbers(arguments)
    refuse_empty_texts(arguments)
    for name in _OUTPUTS:
        out = getattr(arguments, name, None)
        if isinstance(out, Path) or (isinstance(out, str) and not _URL.match(out)):
            require_writable(Path(out), f"--{name}")
    return arguments


def help_text(*, default: str | None = None, metavar: str | None = None, name: str | None = None) -> Any:
    """Return the annotation of an option for its help text, for `typing.Annotated`.

    Args:
        default: the default in words, for an option that may be left out and has no value of its own then.
        metavar: the placeholder of the value, in place of its type.
        name: the name of the option, where that of its field will not do.
    """
    hint = None if default is None else f"(default: {default})"
    return tyro.conf.arg(name=name, metavar=metavar, help_behavior_hint=hint)


def require_writable(out: Path, place: str) -> None:
    """Require that the nearest existing folder above a path, or the path itself, can be written.

    Raises:
        UsageError: it lies below a file, or there is no permission.
    """
    path = out.absolute()
    nearest = next(folder for folder in (path, *path.parents) if folder.exists() or folder.is_symlink())
    if nearest != path and not nearest.is_dir():
        raise UsageError(
            f"cannot be written: {nearest} is a file", file=out, place=place, expected="a place in a folder",
            remedy=f"name another place with {place}",
        )  # fmt: skip
    if not os.access(nearest, os.W_OK):
        raise UsageError(
            f"cannot be written: no permission to write {nearest}", file=out, place=place,
            expected="a place that you may write", remedy=f"name another place with {place}",
        )  # fmt: skip


@_REGISTRY.primitive_rule
def _spec_without_none(type_info: PrimitiveTypeInfo) -> PrimitiveConstructorSpec[Any] | None:
    """Parse ``X | None`` as X: None is what an option has that is left out, and no word of the command line."""
    members = [member for member in get_args(type_info.type) if member is not NoneType]
    if NoneType not in get_args(type_info.type) or len(members) != 1:
        return None
    spec = ConstructorRegistry.get_primitive_spec(PrimitiveTypeInfo.make(members[0], type_info.markers))
    if not isinstance(spec, PrimitiveConstructorSpec):
        return None
    return replace(
        spec,
        is_instance=lambda value: value is None or spec.is_instance(value),
        str_from_instance=lambda value: ["none"] if value is None else spec.str_from_instance(value),
    )


def run_subcommand(words: Sequence[str], command: str, subcommands: Mapping[str, Subcommand]) -> int:
    """Run the subcommand that the first word names; without a word or for ``--help``, list the subcommands.

    Args:
        words: the words after the command.
        command: the command as it is typed, such as ``mirror submission``.
        subcommands: by name.

    Returns:
        The exit code.

    Raises:
        UsageError: there is no subcommand of this name.
        MirrorError: that of the subcommand, whose name it has then.
    """
    if words and words[0] in subcommands:
        try:
            return subcommands[words[0]].run(words[1:])
        except MirrorError as error:
            error.command = f"{command} {words[0]}"
            raise
    if words and words[0] not in ("-h", "--help"):
        listed = ", ".join(f"`{command} {name}`" for name in subcommands)
        raise UsageError(f"`{command}` has no subcommand {words[0]!r}", expected=listed)
    width = max(map(len, subcommands))
    print(f"usage: {command} {'|'.join(subcommands)} [options]\n")
    for name, subcommand in subcommands.items():
        print(f"  {name:<{width}}  {subcommand.summary}")
    print(f"\n`{command} {next(iter(subcommands))} --help` explains a subcommand.")
    return ExitCode.DONE if words else ExitCode.COULD_NOT_RUN


def apply_new_names(words: Sequence[str], command: str, renamed: Mapping[str, str]) -> list[str]:
    """Replace old option names by the new ones, with a note on standard error for each.

    Args:
        words: the words after the command.
        command: the command as it is typed, for the note.
        renamed: new names by old names, such as ``{"--half": "--fp16"}``. A new name without hyphens is a positional
            argument, which then goes before all other words; one in brackets is optional, and goes behind them.
    """
    first: list[str] = []
    others: list[str] = []
    last: list[str] = []
    rest = iter(words)
    for word in rest:
        option, equals, value = word.partition("=")
        # tyro takes underscores for hyphens, and `--no-` before a switch.
        old = option.replace("_", "-")
        negated = old.startswith("--no-") and f"--{old[5:]}" in renamed
        new = renamed.get(f"--{old[5:]}" if negated else old)
        if new is None:
            others.append(word)
            continue
        if not new.startswith("--"):
            print(f"{command}: {old} is now the argument {new}", file=sys.stderr)
            (last if new.startswith("[") else first).append(value if equals else next(rest, ""))
            continue
        new = f"--no-{new[2:]}" if negated else new
        print(f"{command}: {old} is now called {new}", file=sys.stderr)
        others.append(f"{new}{equals}{value}")
    return [*first, *others, *last]


def is_url(text: str) -> bool:
    """Return whether a word is a URL, and no path: fsspec chains such as ``zip::FILE`` count as URLs."""
    return _URL.match(text) is not None


def local_path(path: Path, place: str | None = None) -> Path:
    """Return a path of the command line unchanged, or refuse it if it is a URL.

    Args:
        path: of a file or folder, whether or not it exists.
        place: the option that has this value.

    Raises:
        UsageError: it is a URL: `Path` would read ``s3://bucket`` as a folder ``s3:``.
    """
    if _URL.match(str(path)):
        raise UsageError(
            "this verb takes a path, not a URL",
            file=re.sub(r":/(?!/)", "://", str(path), count=1),
            place=place,
            expected="a path on this machine: remote storage is not supported here yet",
            remedy="copy what is there to this machine first (`mirror dataset fetch URL --scene ID --out FOLDER` brings"
            " a part of a dataset), or copy what is written here to the bucket afterwards; `mirror ingest`, `index`,"
            " `check`, `info`, `stats`, `report` and `dataset gc` take URLs of datasets",
        )
    return path


def refuse_urls(arguments: _Arguments) -> _Arguments:
    """Return parsed arguments unchanged, or refuse a URL among their paths.

    Raises:
        UsageError: the value of a field of type `Path` is a URL.
    """
    for value in vars(arguments).values():
        for item in value if isinstance(value, tuple) else (value,):
            if isinstance(item, Path):
                local_path(item)
    return arguments


def refuse_numbers(arguments: object) -> None:
    """Require that all numbers of parsed arguments, also in groups of options, are usable in computations.

    Raises:
        UsageError: a number is NaN or infinite, or a whole number does not fit into 64 bits.
    """
    for name, value in vars(arguments).items():
        place = f"--{name.replace('_', '-')}"
        for item in value if isinstance(value, tuple) else (value,):
            if is_dataclass(item) and not isinstance(item, type):
                refuse_numbers(item)
            elif isinstance(item, float) and not math.isfinite(item):
                raise UsageError(
                    f"{item}", place=place, expected="a finite number",
                    remedy=f"give another number with {place}",
                )  # fmt: skip
            elif isinstance(item, int) and not -(2**63) <= item < 2**63:
                raise UsageError(
                    f"{item}", place=place, expected="a whole number of at most 64 bits",
                    remedy=f"give another number with {place}",
                )  # fmt: skip


def refuse_empty_texts(arguments: object) -> None:
    """Refuse options with an empty text, also in groups of options.

    Raises:
        UsageError: the value of an option is empty, or blank.
    """
    for option in fields(arguments):  # type: ignore[arg-type]  # every object of arguments is a dataclass
        value = getattr(arguments, option.name)
        place = f"--{option.name.replace('_', '-')}"
        for item in value if isinstance(value, tuple) else (value,):
            if is_dataclass(item) and not isinstance(item, type):
                refuse_empty_texts(item)
            elif isinstance(item, str) and not item.strip() and option.default not in (MISSING, value):
                raise UsageError(
                    "the text is empty", place=place, expected="a text", remedy=f"give one, or leave {place} out"
                )


def parse_settings(words: Sequence[str]) -> dict[str, str]:
    """Read the values of ``--set``: settings of a method, annotator or describer by name.

    Args:
        words: of the form NAME=VALUE.

    Raises:
        UsageError: a word has another form.
    """
    invalid = [word for word in words if not all(word.partition("="))]
    if invalid:
        raise UsageError(f"{invalid[0]!r}", place="--set", expected="NAME=VALUE")
    return {name: value for name, _, value in (word.partition("=") for word in words)}
