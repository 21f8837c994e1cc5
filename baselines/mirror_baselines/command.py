"""``mirror baseline DATASET --method FLOOR``: write the submission of a floor."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode

_EXAMPLES = (
    "mirror baseline demo/dataset --method nearest_frame --split novel --out floor",
    "mirror baseline demo/block/dataset --method mean_color --split novel --protocol lane-shift --out floor",
)


@dataclass(frozen=True)
class Arguments:
    """Write the submission of a floor, a baseline that every method must beat. `mirror evaluate` scores it.

    nearest_frame submits the recorded image with the nearest camera, grey_frame its luma in all channels, mean_color
    the mean colour of the camera.
    """

    dataset: tyro.conf.Positional[str]
    """Folder or URL of the dataset."""
    method: Literal["nearest_frame", "grey_frame", "mean_color"]
    """The floor."""
    split: Annotated[str, help_text(metavar="NAME")]
    """Name of the split."""
    out: Annotated[Path, help_text(metavar="FOLDER")]
    """A new or empty folder for the submission, or the folder of an interrupted run with the same options."""
    protocol: Annotated[str, help_text(metavar="NAME")] = "static-reconstruction"
    """Name of a protocol, or path of its .toml file."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    words = list(argv)
    if words and words[0] in ("nearest_frame", "mean_color"):
        print(f"mirror baseline: the floor is now an option: --method {words[0]}", file=sys.stderr)
        words = [*words[1:], "--method", words[0]]
    arguments = parse_arguments(Arguments, words, "mirror baseline", examples=_EXAMPLES)

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
