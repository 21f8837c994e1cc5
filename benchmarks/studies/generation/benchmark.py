"""Generates traffic over the synthetic street and measures it: conditioning, edits, drift, steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro


@dataclass(frozen=True)
class Arguments:
    """A part of the study. Every part resumes where it was interrupted."""

    what: tyro.conf.Positional[Literal["clips"]]
    """clips: render the clips that all other parts use: 20 core-minutes."""
    out: Path = Path("benchmarks/out/generation")
    """Folder of the study."""


def main(argv: Sequence[str]) -> int:
    """Run a part of the study."""
    arguments = tyro.cli(Arguments, args=list(argv), prog="python -m benchmarks generation")

    from benchmarks.studies.generation.make_clips import make_clips
    from mirror.errors import ExitCode
    from mirror.progress import progress_bar

    with progress_bar(quiet=False) as bar:
        clips = make_clips(arguments.out / "clips", bar)
    print(f"{len(clips.training)} training clips and {len(clips.test)} test clips in {arguments.out / 'clips'}")
    return ExitCode.DONE
