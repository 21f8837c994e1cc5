"""``mirror recording new --out RECORDING``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from mirror.cli.ingest import reader_options
from mirror.command_line import Subcommand, help_text, parse_arguments, run_subcommand
from mirror.errors import ExitCode, UsageError

_COMMAND = "mirror recording new"
_EXAMPLES = (
    "mirror recording new --poses track.csv --camera front_wide=drive.mp4 --lens front_wide=lens.yaml"
    " --mounting front_wide=1.5,0,1.4,0,0,0 --out recording",
    "mirror recording new --camera front_wide=phone.mp4 --drive-id monday --start front_wide=2026-03-01T10:00:00Z"
    " --out recording",
)


@dataclass(frozen=True)
class RecordingArguments:
    """Make a recording from a track and from images or videos, with lenses, mountings and offsets of their clocks.

    The recording has the folder layout; `mirror ingest` reads it. Images and videos are linked, or copied to another
    file system. What the track cannot give is said. Options of a camera have the form NAME=VALUE and are repeated.
    """

    out: Annotated[Path, help_text(metavar="RECORDING")]
    """Folder of the new recording, absent or empty."""
    poses: Annotated[Path | None, help_text(default="none", metavar="FILE")] = None
    """Track: CSV, GPX, NMEA or any other recording with poses. Without it `mirror poses` finds the poses."""
    camera: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME=PATH")] = ()
    """Folder of JPEGs or PNGs, or a video, of a camera."""
    lens: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME=FILE")] = ()
    """YAML file of a lens: OpenCV, ROS, or Kalibr (FILE:cam0). Without it the camera is uncalibrated."""
    mounting: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME=X,Y,Z,ROLL,PITCH,YAW")] = ()
    """Place (m) and angles (degrees about x forward, y left, z up) of a camera; seven numbers: quaternion and place."""
    static_mask: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME=FILE")] = ()
    """PNG of the size of the images, white where they show the vehicle itself, such as its bonnet."""
    times: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME=FILE")] = ()
    """CSV with the times of a camera: file (frame of a video) and timestamp_ns, timestamp or exposures."""
    start: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME=TIME")] = ()
    """Time of the first frame of a video, such as 2026-03-01T10:00:00.250Z or Unix nanoseconds."""
    time_offset_s: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="NAME=SECONDS")] = ()
    """Seconds to add to the times of a camera, so that its clock agrees with that of the track."""
    tz: Annotated[str | None, help_text(default="none", metavar="ZONE")] = None
    """Time zone of times without one, in the track and of the cameras, such as Europe/Berlin."""
    reader: Annotated[str | None, help_text(default="recognised from the files", metavar="NAME")] = None
    """Reader of the track."""
    columns: Annotated[str | None, help_text(default="recognised from the header")] = None
    """Names of columns of a CSV track, such as time=Date+Time,lon=LON,lat=LAT."""
    option: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="KEY=VALUE")] = ()
    """Another option of the reader, such as frame=NAME for positions x, y in metres."""
    drive_id: Annotated[str | None, help_text(default="from the track", metavar="ID")] = None
    """Id of the drive."""
    vehicle_id: Annotated[str | None, help_text(default="from the track, or unknown", metavar="ID")] = None
    """Pseudonym of the vehicle."""
    vehicle_type: Annotated[str | None, help_text(default="from the track, or unknown", metavar="WORD")] = None
    """Make or class of the vehicle."""
    rig_id: Annotated[str | None, help_text(default="rig_ and the vehicle", metavar="ID")] = None
    """Name of the set of cameras, the same for all vehicles that have it."""
    reference_camera: Annotated[str | None, help_text(default="front_wide, or the first", metavar="NAME")] = None
    """Camera whose exposures define the frames."""
    licence: Annotated[str | None, help_text(default="none", metavar="NAME")] = None
    """Licence of the recording."""
    city: Annotated[str | None, help_text(default="none", metavar="NAME")] = None
    """City of the drive."""
    json: bool = False
    """Print the result as JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    summary = "make a recording from a track and from images or videos"
    return run_subcommand(argv, "mirror recording", {"new": Subcommand(summary, _new)})


def _new(argv: Sequence[str]) -> int:
    arguments = parse_arguments(RecordingArguments, argv, _COMMAND, examples=_EXAMPLES)

    from mirror.recordings.assembly.assemble import DriveNames, assemble_recording
    from mirror.recordings.assembly.cameras import GivenCamera
    from mirror.recordings.boundary import reader_errors
    from mirror.recordings.registry import find_reader
    from mirror.schema.folders import require_output_folder

    require_output_folder(arguments.out)
    paths = _by_camera(arguments.camera, "--camera")
    stated = {
        name: _by_camera(getattr(arguments, name), f"--{name.replace('_', '-')}", known=paths)
        for name in ("lens", "mounting", "static_mask", "times", "start", "time_offset_s")
    }
    cameras = [
        GivenCamera(
            name, Path(path), stated["lens"].get(name), stated["mounting"].get(name),
            Path(stated["times"][name]) if name in stated["times"] else None,
            stated["start"].get(name), _seconds(stated["time_offset_s"].get(name, "0"), name),
            Path(stated["static_mask"][name]) if name in stated["static_mask"] else None,
        )
        for name, path in paths.items()
    ]  # fmt: skip
    if arguments.poses is None and arguments.drive_id is None:
        raise UsageError("a recording without a track", place="--drive-id", expected="the id of the drive")
    with reader_errors(arguments.poses or arguments.out):
        poses = None
        if arguments.poses is not None:
            reader = find_reader(arguments.poses, arguments.reader)
            zone = arguments.tz if reader.name == "csv" else None
            options = reader_options(arguments.option, tz=zone, columns=arguments.columns)
            poses = reader.open(arguments.poses, options)
        names = DriveNames(
            arguments.drive_id, arguments.vehicle_id, arguments.vehicle_type, arguments.rig_id,
            arguments.reference_camera, arguments.licence, arguments.city,
        )  # fmt: skip
        made = assemble_recording(arguments.out, poses, cameras, names, arguments.tz)
    if arguments.json:
        print(json.dumps({"recording": str(arguments.out), **vars(made)}))
        return ExitCode.DONE
    from mirror.cli.output import plain_console

    console = plain_console(soft_wrap=True)
    for note in made.notes:
        console.print(note)
    images = ", ".join(f"{count} of {name}" for name, count in made.images.items())
    console.print(f"{arguments.out}: {made.poses} poses; images: {images}")
    if poses is None:
        console.print(f"next: mirror poses {arguments.out} --camera-height-m METRES --out POSED")
        return ExitCode.DONE
    console.print(f"next: mirror rois propose {arguments.out} --min-traversals 1 --out rois.geojson")
    console.print(f"      mirror ingest {arguments.out} --rois rois.geojson --out DATASET")
    return ExitCode.DONE


def _by_camera(words: Sequence[str], place: str, known: dict[str, str] | None = None) -> dict[str, str]:
    """Values by camera of an option that is repeated."""
    found: dict[str, str] = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not (name and equals and value):
            raise UsageError(f"{word!r} is not NAME=VALUE", place=place, expected="a camera's name, =, and its value")
        if name in found:
            raise UsageError(f"camera {name!r} is given twice", place=place, expected="each camera once")
        if known is not None and name not in known:
            raise UsageError(
                f"there is no camera {name!r}", place=place, expected=f"one of {', '.join(known) or 'no cameras'}",
                remedy="name it as in --camera",
            )  # fmt: skip
        found[name] = value
    return found


def _seconds(text: str, camera: str) -> float:
    import math

    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not math.isfinite(seconds):
        raise UsageError(f"{text!r} is no number of seconds", place=f"--time-offset-s {camera}", expected="seconds")
    return seconds
