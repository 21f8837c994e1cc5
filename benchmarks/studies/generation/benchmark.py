"""Generates traffic over the synthetic street and measures it: conditioning, edits, drift, steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from mirror.errors import ExitCode
from mirror.progress import ProgressReporter


@dataclass(frozen=True)
class Arguments:
    """A part of the study. Every part resumes where it was interrupted."""

    what: tyro.conf.Positional[Literal["clips", "judges"]]
    """clips: render the clips that all other parts use: 25 core-minutes. judges: train the segmenter and the
    classifier, and check them on true images: 6 core-minutes."""
    out: Path = Path("benchmarks/out/generation")
    """Folder of the study."""


def main(argv: Sequence[str]) -> int:
    """Run a part of the study."""
    arguments = tyro.cli(Arguments, args=list(argv), prog="python -m benchmarks generation")

    from mirror.progress import progress_bar

    with progress_bar(quiet=False) as bar:
        if arguments.what == "clips":
            _clips(arguments.out, bar)
        else:
            _judges(arguments.out, bar)
    return ExitCode.DONE


def _clips(out: Path, progress: ProgressReporter) -> None:
    from benchmarks.studies.generation.make_clips import make_clips

    clips = make_clips(out / "clips", progress)
    print(f"{len(clips.training)} training clips and {len(clips.test)} test clips in {out / 'clips'}")


def _judges(out: Path, progress: ProgressReporter) -> None:
    from benchmarks.studies.generation.train_judges import train_judges

    for name, figure in train_judges(out / "clips", out / "judges", progress).items():
        print(f"{name:30} {figure:.3f}" if isinstance(figure, float) else f"{name:30} {figure}")
