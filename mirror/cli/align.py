"""``mirror align DATASET``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode

_EXAMPLES = (
    "mirror align demo/dataset",
    "mirror align demo/dataset --scene guangzhou-urban --step-m 1 --radius-m 16 --version 2 --json",
)


@dataclass(frozen=True)
class AlignArguments:
    """Bring the passes of one street on different days into one frame from their images, as a layer of poses.

    For passes whose poses are off by metres, as those of consumer GPS; `mirror calibrate refine` starts within a few
    decimetres. Images of all passes are mapped together (structure from motion, SIFT on evened contrast); a pass that
    cannot be matched keeps its poses and is named. Choose the layer with --poses aligned@VERSION. Needs pycolmap (extra
    calibration). Exit codes: 0 all passes are aligned, 2 could not run, 3 some keep their poses.
    """

    dataset: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    scene: Annotated[str | None, help_text(default="all", metavar="ID")] = None
    """Scene to align."""
    version: Annotated[str, help_text(metavar="NAME")] = "1"
    """Version of the layer aligned@VERSION; an existing layer is kept."""
    cameras: Annotated[str | None, help_text(default="the reference camera", metavar="NAME,...")] = None
    """Cameras whose images are matched."""
    step_m: float = 2.0
    """Distance between the used images of a pass, metres."""
    radius_m: float = 12.0
    """Distance of images of two passes up to which they are matched, metres: twice the error of a position, and 2 m."""
    partners: int = 3
    """Number of images of each other pass that an image is matched with."""
    least_share: float = 0.5
    """Smallest share of the images of a pass that must be registered."""
    poses: Annotated[str | None, help_text(default="recorded", metavar="SOURCE@VERSION")] = None
    """Layer of poses to start from."""
    calibrations: Annotated[str | None, help_text(default="recorded", metavar="SOURCE@VERSION")] = None
    """Layer of calibrations."""
    boxes: Annotated[str | None, help_text(default="the only one", metavar="SOURCE@VERSION")] = None
    """Layer of boxes, which mask moving road users."""
    json: bool = False
    """Print the result as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(AlignArguments, argv, "mirror align", examples=_EXAMPLES)

    from mirror.dataset import open as open_dataset
    from mirror.localisation.alignment.options import AlignmentOptions
    from mirror.localisation.alignment.run import align_passes
    from mirror.progress import progress_bar

    options = AlignmentOptions(
        cameras=tuple(arguments.cameras.split(",")) if arguments.cameras else (), step_m=arguments.step_m,
        radius_m=arguments.radius_m, partners=arguments.partners, least_share=arguments.least_share,
    )  # fmt: skip
    dataset = open_dataset(arguments.dataset)
    view = dataset.with_layers(poses=arguments.poses, calibrations=arguments.calibrations, boxes=arguments.boxes)
    view = view if arguments.scene is None else view.where(scene=arguments.scene)
    with progress_bar(quiet=arguments.json) as progress:
        report = align_passes(view, version=arguments.version, options=options, progress=progress)
    if arguments.json:
        print(json.dumps(report.to_dict()))
    else:
        from mirror.cli.output import plain_console

        console = plain_console(soft_wrap=True)
        for line in report.lines():
            console.print(line)
    aligned = all(one.status in ("aligned", "existing") for one in report.passes)
    return ExitCode.DONE if aligned else ExitCode.PARTLY_DONE
