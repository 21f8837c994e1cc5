"""``mirror poses RECORDING... --out RECORDING``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mirror.cli.ingest import reader_options
from mirror.command_line import help_text, parse_arguments
from mirror.errors import ExitCode, MirrorError, UsageError

_EXAMPLES = (
    "mirror poses demo/recordings/old_town-1 --camera front_wide --scale track --out posed",
    "mirror poses phone --camera-height-m 1.3 --masks road-users --out posed --json",
)


@dataclass(frozen=True)
class PosesArguments:
    """Find the poses of recordings that have none, or GPS alone, in the images of one camera (structure from motion).

    Images between which the image moves are used, without the vehicle itself and road users that may move; an unknown
    lens is estimated. Scale and world come from the track, the rig, the height of the camera above the road or the
    length of the way. What cannot be registered is left out and named; a drive that falls into parts becomes several
    recordings in OUT. Each recording has poses.json with the figures. Needs pycolmap (extra calibration).
    Exit codes: 0 95 % of the used images are registered in one part, 2 could not run or too few are, 3 partly done.
    """

    recordings: Annotated[tyro.conf.Positional[tuple[Path, ...]], help_text(default="none", metavar="RECORDING...")]
    """Recordings, or folders of recordings."""
    out: Annotated[Path, help_text(metavar="RECORDING")]
    """Folder of the new recording, or of several, absent or empty."""
    camera: Annotated[str | None, help_text(default="the reference camera", metavar="NAME")] = None
    """Camera whose images are registered; other cameras follow by their mountings."""
    lens: Annotated[Path | None, help_text(default="recorded, else estimated", metavar="FILE")] = None
    """YAML file of its lens: OpenCV, ROS or Kalibr."""
    scale: Annotated[
        Literal["track", "rig", "height", "length"] | None, help_text(default="the first that there is", metavar="FROM")
    ] = None
    """Source of scale and world: track (fixes), rig (distances of cameras), height (of the camera), length."""
    camera_height_m: Annotated[float | None, help_text(default="recorded", metavar="METRES")] = None
    """Height of the camera above the road."""
    length_m: Annotated[float | None, help_text(default="none", metavar="METRES")] = None
    """Length of the way from the first to the last image."""
    masks: Annotated[Path | None, help_text(default="none", metavar="FOLDER")] = None
    """Masks of road users: CAMERA/TIMESTAMP_NS.png, white where they are. Boxes of the recording count too."""
    motion_percent: float = 1.0
    """Median motion of the image after which the next one is used, percent of the width."""
    neighbours: int = 10
    """Number of following images that an image is matched with."""
    longest_gap_s: float = 2.0
    """The drive is cut where no image is registered for longer, seconds."""
    least_share: float = 0.5
    """Smallest share of the used images that must be registered."""
    reader: Annotated[str | None, help_text(default="recognised from the files", metavar="NAME")] = None
    """Reader of the recordings."""
    option: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="KEY=VALUE")] = ()
    """Option of the reader."""
    json: bool = False
    """Print the result as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(PosesArguments, argv, "mirror poses", examples=_EXAMPLES)

    from mirror.localisation.structure.options import StructureOptions
    from mirror.localisation.structure.report import PosesReport
    from mirror.localisation.structure.run import find_poses, require_pycolmap
    from mirror.progress import progress_bar
    from mirror.recordings.boundary import reader_errors
    from mirror.recordings.discovery import find_recordings
    from mirror.recordings.registry import find_reader
    from mirror.schema.folders import require_output_folder

    if not arguments.recordings:
        raise UsageError("no recordings", place="RECORDING...", expected="recordings, or folders of recordings")
    require_pycolmap()
    require_output_folder(arguments.out)
    options = StructureOptions(
        camera=arguments.camera, lens=arguments.lens, scale=arguments.scale, camera_height_m=arguments.camera_height_m,
        length_m=arguments.length_m, masks=arguments.masks, motion_percent=arguments.motion_percent,
        neighbours=arguments.neighbours, longest_gap_s=arguments.longest_gap_s, least_share=arguments.least_share,
    )  # fmt: skip
    paths = find_recordings(arguments.recordings, arguments.reader).recordings
    reports: list[PosesReport] = []
    failed: list[MirrorError] = []
    for path in paths:
        try:
            with reader_errors(path):
                recording = find_reader(path, arguments.reader).open(path, reader_options(arguments.option))
                out = arguments.out if len(paths) == 1 else arguments.out / recording.info.drive_id
            with progress_bar(quiet=arguments.json) as progress:
                reports.append(find_poses(recording, path, out, options, progress, parts_in=arguments.out))
        except MirrorError as error:
            if len(paths) == 1:
                raise
            failed.append(error)
    if arguments.json:
        said = {"recordings": [report.to_dict() for report in reports], "failed": [one.to_dict() for one in failed]}
        print(json.dumps(said))
    else:
        _print(reports, failed, arguments.out)
    if not reports:
        return ExitCode.COULD_NOT_RUN
    whole = all(report.share >= 0.95 and len(report.parts) == 1 for report in reports)
    return ExitCode.DONE if whole and not failed else ExitCode.PARTLY_DONE


def _print(reports: Sequence[object], failed: Sequence[MirrorError], out: Path) -> None:
    from mirror.cli.output import plain_console
    from mirror.localisation.structure.report import PosesReport

    console = plain_console(soft_wrap=True)
    for report in reports:
        if isinstance(report, PosesReport):
            for line in report.lines():
                console.print(line)
    for error in failed:
        console.print(f"failed: {error}")
    if reports:
        console.print(f"next: mirror rois propose {out} --min-traversals 1 --out rois.geojson")
        console.print(f"      mirror ingest {out} --rois rois.geojson --out DATASET")
