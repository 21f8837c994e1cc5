"""``mirror annotate track``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Final

import tyro

from mirror.annotation.tracking.options import BoxTrackingOptions
from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode

_EXAMPLES: Final = ("mirror annotate track demo/dataset --boxes synth@0.1.0",)


@dataclass(frozen=True)
class TrackArguments:
    """Make tracks of a layer of boxes: ids, smooth positions, velocities and one size for each object.

    The tracks of SOURCE@VERSION become the layer SOURCE-tracks@VERSION. Stationary objects are merged across the
    traversals of a scene.
    """

    dataset: tyro.conf.Positional[Path]
    """Folder of the dataset."""
    boxes: Annotated[str | None, help_text(default="the only layer of boxes", metavar="SOURCE@VERSION")] = None
    """The layer of boxes."""
    version: Annotated[str | None, help_text(default="that of the boxes", metavar="NAME")] = None
    """Version of the layer of tracks."""
    options: tyro.conf.OmitArgPrefixes[BoxTrackingOptions] = field(default_factory=BoxTrackingOptions)
    json: bool = False
    """Print JSON."""


def run(argv: Sequence[str]) -> int:
    """Make tracks of a layer of boxes."""
    arguments = parse_arguments(TrackArguments, argv, "mirror annotate track", examples=_EXAMPLES)

    from mirror.annotation.tracking.layer import track_layer
    from mirror.dataset.writing import open_to_write
    from mirror.progress import progress_bar

    with progress_bar(quiet=arguments.json) as bar:
        report = track_layer(
            open_to_write(arguments.dataset),
            arguments.boxes,
            arguments.options,
            version=arguments.version,
            progress=bar,
        )
    if arguments.json:
        print(json.dumps({"dataset": str(arguments.dataset), **asdict(report)}))
        return ExitCode.DONE
    print(f"layer boxes/{report.layer}: {len(report.written)} traversals written, {len(report.kept)} kept")
    if report.written:
        print(
            f"{report.detections} boxes became {report.tracks} tracks ({report.stationary} stationary)"
            f" with {report.boxes} boxes"
        )
    if report.detections and not report.tracks:
        options = arguments.options
        print(
            f"a track has at least {options.min_boxes} boxes (--min-boxes), at most {options.max_gap_s:g} s apart"
            " (--max-gap-s): are the frames farther apart?"
        )
    return ExitCode.DONE
