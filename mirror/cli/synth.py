"""``mirror synth --out RECORDINGS``."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from mirror.command_line import parse_arguments
from mirror.errors import ExitCode


@dataclass(frozen=True)
class Arguments:
    """Write recordings of a synthetic street, as a fleet would deliver them, and rois.geojson beside them.

    The files depend on the preset, the seed and the numbers alone. After an interruption the same command goes on:
    recordings that are complete are kept.
    """

    out: Path
    """A new or an empty folder, or one in which the same recordings were begun."""
    preset: Literal["demo", "quick", "tiny", "block", "reconstruction", "benchmark", "paper"] = "demo"
    """demo: two scenes; quick: one small scene; tiny: two traversals, for tests; block and
    reconstruction: one and three blocks of a street; benchmark: four scenes of eight
    traversals; paper: ten scenes in six cities, whose pictures are rendered when they are loaded."""
    scenes: int | None = None
    """How many scenes. Default: all that the preset has."""
    traversals: int | None = None
    """Drives with pictures through each scene. Default: the preset's."""
    seed: int = 0
    """Of everything that is left to chance."""
    truth: str = ""
    """Kinds of truth to be written beside each recording, such as depth,boxes: depth, normals, semantic, instance,
    flow, boxes, poses."""
    errors: Literal["default", "none"] = "default"
    """Whether what is recorded differs from the truth, as a fleet's does."""
    without: str = ""
    """Effects that are left out of the pictures, such as noise,motion_blur; docs/synth.md names them all."""
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)
    """Threads."""
    json: bool = False
    """Print the recordings' paths as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror synth")

    from mirror.progress import progress_bar
    from mirror.synth import Effects, Errors, write_recordings
    from mirror.synth.writing.truth import parse_truth_kinds

    with progress_bar(quiet=arguments.json) as bar:
        written = write_recordings(
            arguments.out,
            arguments.preset,
            arguments.seed,
            scenes=arguments.scenes,
            traversals=arguments.traversals,
            errors=Errors.none() if arguments.errors == "none" else None,
            effects=Effects.without(arguments.without.split(",")) if arguments.without else None,
            truth=parse_truth_kinds(arguments.truth),
            workers=arguments.workers,
            progress=bar,
        )
    rois = arguments.out / "rois.geojson"
    counts = {"pictures": written.images, "lost": written.lost, "boxes": written.boxes, "unseen": written.unseen}
    if arguments.json:
        paths = [str(path) for path in written.recordings]
        print(json.dumps({"recordings": paths, "rois": str(rois), **counts}))
    else:
        print(f"{len(written.recordings)} recordings in {arguments.out}, their regions of interest in {rois}")
        print(
            f"{written.images} images ({written.lost} more were lost), {written.boxes} boxes"
            f" ({written.unseen} more road users were near, and in no image)"
        )
    return ExitCode.DONE
