"""``mirror baseline``: write the submission of a floor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Literal

import tyro

from mirror.command_line import parse_arguments
from mirror.errors import ExitCode


@dataclass(frozen=True)
class Arguments:
    """Write the submission of a floor: a method that every other must beat; `mirror evaluate` scores it.

    nearest_frame shows the recorded image that was taken nearest, mean_color the mean colour of the camera.
    """

    method: tyro.conf.Positional[Literal["nearest_frame", "mean_color"]]
    """Which floor."""
    dataset: tyro.conf.Positional[str]
    """The dataset's folder or URL."""
    split: str
    """Name of the split."""
    out: Path
    """A new or an empty folder for the submission, or one in which the same was begun."""
    protocol: str = "static-reconstruction"
    """Name of the protocol, or the path of its .toml."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror baseline")

    import mirror
    from mirror.evaluation.submission.writing import write_submission
    from mirror.progress import progress_bar
    from mirror.protocols.document import load_protocol
    from mirror.protocols.views import plan_views
    from mirror.version import __version__

    floor = import_module(f"mirror_baselines.{arguments.method}")
    dataset = mirror.open(arguments.dataset)
    plan = plan_views(dataset, load_protocol(arguments.protocol), arguments.split)
    with progress_bar(quiet=False) as bar:
        count = write_submission(
            dataset, plan, floor.render, floor.METHOD, floor.APPEARANCE, arguments.out, bar, of=__version__
        )
    print(f"{count} renders: {arguments.out}")
    return ExitCode.DONE
