"""``mirror synth --out RECORDINGS``."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import tyro

from mirror.errors import ExitCode


@dataclass(frozen=True)
class Arguments:
    """Write recordings of a synthetic street, as a fleet would deliver them, and rois.geojson beside them.

    The files depend on the preset, the seed and the numbers alone.
    """

    out: Path
    """An empty folder, or one to be made."""
    preset: Literal["demo", "quick", "tiny"] = "demo"
    """demo: two scenes; quick: one small scene; tiny: two traversals, for tests."""
    scenes: int | None = None
    """How many scenes. Default: all that the preset has."""
    traversals: int | None = None
    """Drives with pictures through each scene. Default: the preset's."""
    seed: int = 0
    """Of everything that is left to chance."""
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)
    """Threads."""
    json: bool = False
    """Print the recordings' paths as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = tyro.cli(Arguments, args=list(argv), prog="mirror synth")

    from mirror.cli.progress import progress_bar
    from mirror.synth import write_recordings

    with progress_bar(quiet=arguments.json) as bar:
        recordings = write_recordings(
            arguments.out,
            arguments.preset,
            arguments.seed,
            scenes=arguments.scenes,
            traversals=arguments.traversals,
            workers=arguments.workers,
            progress=bar,
        )
    rois = arguments.out / "rois.geojson"
    if arguments.json:
        print(json.dumps({"recordings": [str(path) for path in recordings], "rois": str(rois)}))
    else:
        print(f"{len(recordings)} recordings in {arguments.out}, their regions of interest in {rois}")
    return ExitCode.DONE
