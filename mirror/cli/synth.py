"""``mirror synth --out RECORDINGS``."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from mirror.command_line import help_text, parse_arguments
from mirror.counting import count_of
from mirror.errors import ExitCode

_EXAMPLES = (
    "mirror synth --preset demo --scenes 1 --truth depth,boxes --out recordings",
    "mirror synth --preset benchmark --secret --out recordings",
)


@dataclass(frozen=True)
class Arguments:
    """Write recordings of a synthetic street, as a fleet would deliver them, and their regions in rois.geojson.

    The files depend only on the options. After an interruption the same command continues and keeps the complete
    recordings.
    """

    out: Path
    """A new or empty folder, or the folder of an interrupted run with the same options."""
    preset: Annotated[
        Literal[
            "demo",
            "quick",
            "tiny",
            "block",
            "block-960",
            "calibration",
            "reconstruction",
            "benchmark",
            "annotation",
            "paper",
        ],
        help_text(metavar="NAME"),
    ] = "demo"
    """demo: two scenes. quick: one small scene. tiny: two traversals, for tests. benchmark: four scenes of eight
    traversals. block, reconstruction: one and three blocks of a street. block-960: the block 960 pixels wide.
    calibration: one drive with images at the
    rate that `mirror calibrate` needs.
    annotation: small images of ten scenes, to train `mirror annotate train`.
    paper: ten scenes in six cities, with images that are rendered when they are loaded."""
    scenes: Annotated[int | None, help_text(default="all of the preset")] = None
    """Number of scenes."""
    traversals: Annotated[int | None, help_text(default="that of the preset")] = None
    """Number of drives with images through each scene."""
    seed: int = 0
    """Seed of all random choices. Whoever knows it can make the recordings again: they are a practice set."""
    secret: bool = False
    """Draw a seed of 128 random bits in place of --seed, and keep it in OUT/secret.json, which is not to be published.
    `mirror submission hidden` reads it there."""
    truth: Annotated[str, help_text(default="none", metavar="KIND,...")] = ""
    """Truth to write beside each recording: depth, normals, semantic, instance, flow, boxes, poses."""
    errors: Literal["default", "none"] = "default"
    """default: recorded poses and calibrations have errors, as in a fleet. none: they are exact."""
    without: Annotated[str, help_text(default="none", metavar="EFFECT,...")] = ""
    """Effects to leave out of the images, such as noise,motion_blur; docs/synth.md lists them."""
    rolling_shutter: Annotated[str, help_text(default="global shutters", metavar="[CAMERA=]DIRECTION:MS,...")] = ""
    """Rolling shutters: top_to_bottom:30 for all cameras, or front_wide=top_to_bottom:30,rear=left_to_right:12.
    Each row or column is rendered where the vehicle and the traffic are at its own time."""
    workers: int = field(default_factory=lambda: os.cpu_count() or 1)
    """Number of threads."""
    json: bool = False
    """Print the paths of the recordings as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror synth", examples=_EXAMPLES)

    from mirror.progress import progress_bar
    from mirror.synth import SECRET, Effects, Errors, parse_readouts, parse_truth_kinds, write_recordings

    with progress_bar(quiet=arguments.json) as bar:
        written = write_recordings(
            arguments.out,
            arguments.preset,
            arguments.seed,
            secret=arguments.secret,
            scenes=arguments.scenes,
            traversals=arguments.traversals,
            errors=Errors.none() if arguments.errors == "none" else None,
            effects=Effects.without(arguments.without.split(",")) if arguments.without else None,
            readouts=parse_readouts(arguments.rolling_shutter),
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
        print(
            f"{count_of(len(written.recordings), 'recording')} in {arguments.out}, their regions of interest in {rois}"
        )
        print(
            f"{count_of(written.images, 'image')} ({written.lost} more lost), {written.boxes:,} boxes"
            f" ({written.unseen} more road users were near but in no image)"
        )
        if arguments.secret:
            print(f"{arguments.out / SECRET} holds the secret seed: keep a copy, and publish neither")
    return ExitCode.DONE
