"""The command line of methods that render a submission: ``python -m METHOD DATASET --split NAME --out SUBMISSION``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from mirror.command_line import parsed
from mirror.errors import ExitCode, MirrorError

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
    try:
        return _write(parsed(Arguments, argv, f"python -m {method.name}"), renderer, method, appearance)
    except MirrorError as error:
        print(f"{method.name}: {error}", file=sys.stderr)
        return ExitCode.COULD_NOT_RUN


def _write(arguments: Arguments, renderer: Renderer, method: Method, appearance: Appearance) -> ExitCode:
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
