"""The command line of methods that render a submission: ``python -m METHOD DATASET --split NAME --out SUBMISSION``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from mirror.command import run_command
from mirror.command_line import parsed
from mirror.errors import ExitCode

if TYPE_CHECKING:
    from mirror.evaluation.submission.manifest import Appearance, Method
    from mirror.evaluation.submission.writing import Renderer


@dataclass(frozen=True)
class Arguments:
    """Write this method's submission; `mirror evaluate` scores it."""

    dataset: tyro.conf.Positional[str]
    """The dataset's folder or URL."""
    split: str
    """Name of the split."""
    out: Path
    """A new or an empty folder for the submission."""
    protocol: str = "static-reconstruction"
    """Name of the protocol, or the path of its .toml."""


def method_main(argv: Sequence[str], renderer: Renderer, method: Method, appearance: Appearance) -> int:
    """Write the submission that a command line asks for.

    Args:
        argv: its words.
        renderer: of the method.
        method: for the manifest; its name is that of the package.
        appearance: for the manifest.

    Returns:
        The exit code (`ExitCode`).
    """
    command = f"python -m {method.name}"
    return run_command(command, lambda: _write(argv, command, renderer, method, appearance))


def _write(argv: Sequence[str], command: str, renderer: Renderer, method: Method, appearance: Appearance) -> int:
    arguments = parsed(Arguments, argv, command)

    import mirror
    from mirror.evaluation.submission.writing import write_submission
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol
    from mirror.protocols.views import plan_views

    dataset = mirror.open(arguments.dataset)
    plan = plan_views(dataset, load_protocol(arguments.protocol), arguments.split)
    with progress_bar(quiet=False) as bar:
        count = write_submission(dataset, plan, renderer, method, appearance, arguments.out, bar)
    print(f"{count} renders: {arguments.out}")
    return ExitCode.DONE
