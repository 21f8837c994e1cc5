"""How every command ends: errors as messages, interruptions as 130, and quietly where nobody reads its output."""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Final, Literal, NamedTuple

from mirror.errors import ExitCode, MirrorError, UsageError
from mirror.stops import INTERRUPTED, interrupted, terminable

_SHOWN: Final = 80
ENTRY_POINT_GROUP: Final = "mirror.commands"
Group = Literal["data", "benchmark", "reconstruction"]


class Command(NamedTuple):
    """A verb of ``mirror``; other packages add theirs by entry points of the group ``mirror.commands``.

    Attributes:
        group: under which ``mirror --help`` lists it.
        summary: one line for ``mirror --help``.
        module: it has a function ``main(argv) -> exit code``; imported only when the verb is run.
    """

    group: Group
    summary: str
    module: str


CLOSED_PIPE: Final = 141
"""Exit code of a command that had more to say and nobody read it: what a shell gives for SIGPIPE."""


def run_command(command: str, work: Callable[[], int], words: Sequence[str] = (), *, as_json: bool = False) -> int:
    """Do a command's work in a process that may go on afterwards, and return the exit code.

    Args:
        command: as it is typed, for messages.
        work: it returns the exit code.
        words: those after the command, for remedies that name the option at fault.
        as_json: print errors on standard output as JSON too.

    Returns:
        The exit code.

    Raises:
        SystemExit: the command line was wrong, or asked for help.
    """
    try:
        code = _done(command, work, words, as_json=as_json)
    except SystemExit as asked:
        # rich asks for it where a pipe is closed.
        if isinstance(asked.__context__, BrokenPipeError):
            return _say_no_more(CLOSED_PIPE)
        if (code := _flushed(command, ExitCode.DONE)) != ExitCode.DONE:
            return code
        raise
    except BrokenPipeError:
        return _say_no_more(CLOSED_PIPE)
    return _flushed(command, code)


def _done(command: str, work: Callable[[], int], words: Sequence[str], *, as_json: bool) -> int:
    try:
        with terminable(), _named_paths():
            return int(work())
    except MirrorError as error:
        return _refuse(command, error, words, as_json=as_json)
    except KeyboardInterrupt:
        print(interrupted(command), file=sys.stderr)
        return INTERRUPTED
    except (BrokenPipeError, SystemExit):
        raise
    except ModuleNotFoundError as error:
        from mirror.plugins import error_in_plugin

        missing = error_in_plugin(error) or _missing_package(command, error)
        if missing is None:
            raise
        return _refuse(command, missing, words, as_json=as_json)
    except Exception as error:
        from mirror.plugins import error_in_plugin

        named = error_in_plugin(error)
        if named is None:
            raise
        return _refuse(command, named, words, as_json=as_json)


_EXTRAS: Final = {
    "generate": "generation", "simulate": "simulator", "serve": "simulator", "torch": "models", "scipy": "models",
    "safetensors": "models", "diffusers": "generation", "gymnasium": "simulator", "grpc": "simulator",
    "google": "simulator", "av": "video", "matplotlib": "view", "rerun": "view", "viser": "view", "duckdb": "sql",
    "pycolmap": "calibration", "onnxruntime": "privacy", "PIL": "privacy", "mcap": "mcap", "gsplat": "baselines",
    "cryptography": "leaderboard", "aiohttp": "http", "s3fs": "s3", "ray": "cluster",
}  # fmt: skip
"""The extra that brings a package, by the package's import name; of some verbs, the extra that brings all they need."""


def _missing_package(command: str, error: ModuleNotFoundError) -> UsageError | None:
    """Name the extra with a package that is not installed; None: the package belongs to no extra."""
    package, verb = (error.name or "").partition(".")[0], [*command.split(), "", ""][1]
    if package not in _EXTRAS:
        return None
    from mirror.installation import install_command

    extra = _EXTRAS.get(verb if package in ("torch", "scipy", "safetensors") else package, _EXTRAS[package])
    return UsageError(
        f"it needs the package {package}, which is not installed", expected=f"the extra {extra}",
        remedy=install_command(extra),
    )  # fmt: skip


def _refuse(command: str, error: MirrorError, words: Sequence[str], *, as_json: bool) -> int:
    from mirror.remedies import complete_remedy

    complete_remedy(error, command, words)
    if as_json:
        import json

        print(json.dumps(error.to_dict()))
    print(f"{error.command or command}: {error}", file=sys.stderr)
    return ExitCode.COULD_NOT_RUN


@contextmanager
def _named_paths() -> Iterator[None]:
    """Turn the system's error for a path that no file system can have into one that names it."""
    try:
        yield
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        raise UsageError(
            f"this name is too long for a file: {str(error.filename)[:_SHOWN]}...",
            expected="at most 255 bytes in each part of a path",
            remedy="give it a shorter name",
        ) from error


def _flushed(command: str, code: int) -> int:
    """Write what is buffered: the interpreter's own attempt, when it ends, would print an error."""
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        # The work is done, and the reader wanted no more of what is said about it.
        return _say_no_more(code)
    except OSError as error:
        print(f"{command}: standard output cannot be written: {error.strerror}", file=sys.stderr)
        return _say_no_more(ExitCode.COULD_NOT_RUN)
    return code


def _say_no_more(code: int) -> int:
    """Send what is still buffered nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(nowhere, stream.fileno())
    return code
