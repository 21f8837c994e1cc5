"""``mirror protocols list`` and ``mirror protocols show PROTOCOL``."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

from mirror.command_line import Subcommand, help_text, parse_arguments, run_subcommand
from mirror.errors import ExitCode

_LIST_EXAMPLES: Final = ("mirror protocols list", "mirror protocols list --json")
_SHOW_EXAMPLES: Final = (
    "mirror protocols show static-reconstruction",
    "mirror protocols show mine.toml --json",
)


@dataclass(frozen=True)
class ProtocolListArguments:
    """List the protocols of the toolkit: their task, and whether they need boxes or masks of road users."""

    json: bool = False
    """Print the list as JSON."""


@dataclass(frozen=True)
class ShowArguments:
    """Print a protocol as TOML. A changed copy with another name is a protocol: --protocol mine.toml."""

    name: Annotated[tyro.conf.Positional[str], help_text(metavar="PROTOCOL")]
    """Name of a protocol, as `mirror protocols list` shows it, or the path of its .toml file, which is checked."""
    json: bool = False
    """Print the protocol, with all defaults and its hash, as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    subcommands = {
        "list": Subcommand("list the protocols of the toolkit", _list),
        "show": Subcommand("print a protocol as TOML, to use it or to change a copy", _show),
    }
    return run_subcommand(argv, "mirror protocols", subcommands)


def _list(words: Sequence[str]) -> int:
    arguments = parse_arguments(ProtocolListArguments, words, "mirror protocols list", examples=_LIST_EXAMPLES)

    from mirror.protocols.document import load_protocol, protocol_names

    protocols = [load_protocol(name) for name in protocol_names()]
    if arguments.json:
        rows = [
            {"name": one.name, "version": one.version, "task": one.task, "hash": one.hash, "masks": one.masks.dynamic}
            for one in protocols
        ]
        print(json.dumps(rows))
        return ExitCode.DONE
    width = max(len(one.name) for one in protocols)
    for one in protocols:
        needs = f"needs {' or '.join(one.masks.dynamic)} of road users" if one.masks.dynamic else "masks no road users"
        print(f"{one.name:<{width}}  version {one.version}; task {one.task}; {needs}")
    return ExitCode.DONE


def _show(words: Sequence[str]) -> int:
    arguments = parse_arguments(ShowArguments, words, "mirror protocols show", examples=_SHOW_EXAMPLES)

    from mirror.protocols.document import load_protocol, read_definition

    protocol = load_protocol(arguments.name)
    if arguments.json:
        print(json.dumps({**protocol.model_dump(mode="json"), "hash": protocol.hash}))
        return ExitCode.DONE
    own = arguments.name.endswith(".toml")
    sys.stdout.write((Path(arguments.name).read_bytes() if own else read_definition(arguments.name)).decode())
    return ExitCode.DONE
