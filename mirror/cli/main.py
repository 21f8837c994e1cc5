"""``mirror VERB ...``: finds the verb's file and runs it.

Nothing heavy is imported before a verb is known, so that ``mirror --help`` answers at once.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from mirror.stops import run_process

if TYPE_CHECKING:
    from mirror.errors import UnwritableError


def main(argv: Sequence[str] | None = None) -> int:
    """Run one verb.

    Args:
        argv: the words after ``mirror``; default: the command line's, and then the process is the verb's own: signals
            end it.

    Returns:
        The exit code (`ExitCode`, or 130 if it was interrupted).
    """
    if argv is None:
        words = sys.argv[1:]
        return run_process(" ".join(["mirror", *words[:1]]), lambda: main(words))
    from mirror.command import run_command

    command = f"mirror {argv[0]}" if argv and not argv[0].startswith("-") else "mirror"
    return run_command(command, lambda: _run(list(argv)), argv[1:], as_json="--json" in argv)


def _run(words: list[str]) -> int:
    from mirror.cli.verbs import RENAMED, find_command, verb_names
    from mirror.errors import ExitCode, UnwritableError
    from mirror.version import __version__

    if not words or words[0] in ("-h", "--help", "help"):
        print(_help())
        return ExitCode.DONE if words else ExitCode.COULD_NOT_RUN
    if words[0] in ("-V", "--version"):
        print(f"mirror {__version__}")
        return ExitCode.DONE
    verb, rest = RENAMED.get(words[0], words[0]), words[1:]
    if verb != words[0]:
        print(f"mirror: the verb {words[0]} is now called {verb}", file=sys.stderr)
    command = find_command(verb)
    if command is None:
        from mirror.plugins import find_near_name

        near = find_near_name(verb, verb_names())
        hint = "" if near is None else f" Did you mean `mirror {near}`?"
        print(f"mirror: no verb {verb!r}.{hint} `mirror --help` lists them.", file=sys.stderr)
        return ExitCode.COULD_NOT_RUN
    try:
        return int(import_module(command.module).main(rest))
    except UnwritableError as error:
        _name_place(error, rest)
        raise


def _name_place(error: UnwritableError, words: Sequence[str]) -> None:
    """Name the option that gave the place which cannot be written."""
    if error.file is None:
        return
    file = Path(error.file).resolve()
    for word, following in zip(words, [*words[1:], ""]):
        option, equals, value = word.partition("=")
        place = value if equals else following
        if option.startswith("--") and place and file.is_relative_to(Path(place).resolve()):
            error.name_option(option)


def _help() -> str:
    from mirror.cli.verbs import HEADINGS, all_commands

    commands = all_commands()
    width = max(map(len, commands))
    lines = [
        "usage: mirror VERB [options]",
        "",
        "Fleet recordings become a multi-traversal camera dataset; simulators are scored against it.",
    ]
    for group, heading in HEADINGS.items():
        own = [f"  {verb:<{width}}  {command.summary}" for verb, command in commands.items() if command.group == group]
        lines += ["", f"{heading}:", *own]
    lines += [
        "",
        "`mirror VERB --help` explains a verb. Every verb that reports takes --json.",
        "Exit codes: 0 done; 1 findings or a failed check; 2 could not run or wrong usage;",
        "3 partly done (some items failed, the rest is complete); 130 interrupted.",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
