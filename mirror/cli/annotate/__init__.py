"""``mirror annotate``: one module for each subcommand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from mirror.cli.annotate import boxes, describe, export, masks, report, track, train
from mirror.command_line import Subcommand, run_subcommand

_SUBCOMMANDS: Final = {
    "train": Subcommand("train an annotator on the boxes of datasets", train.run),
    "track": Subcommand("make tracks of a layer of boxes", track.run),
    "masks": Subcommand("write masks of road users from a layer of boxes", masks.run),
    "report": Subcommand("write a page of the frames to review, the worst first", report.run),
    "describe": Subcommand("describe frames: captions, light and weather", describe.run),
    "export": Subcommand("write a layer of boxes as nuScenes results, for review", export.run),
}


def main(argv: Sequence[str]) -> int:
    """Run the verb, or one of its subcommands."""
    if argv and argv[0] in _SUBCOMMANDS:
        return run_subcommand(argv, "mirror annotate", _SUBCOMMANDS)
    return boxes.run(argv)
