"""``mirror info DATASET|RECORDING``."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from mirror.cli.ingest import reader_options
from mirror.command_line import help_text, is_url, parse_arguments
from mirror.counting import count_of
from mirror.errors import DatasetError, ExitCode

if TYPE_CHECKING:
    from mirror.integrity.summary import DatasetSummary
    from mirror.recordings.summary import RecordingSummary

_LISTED = 12
_EXAMPLES = ("mirror info demo/dataset", "mirror info demo/block/dataset --json")


@dataclass(frozen=True)
class Arguments:
    """Describe a dataset, or a recording that one of the readers recognises. No image is opened.

    A format such as nuScenes keeps several drives in one folder: for the folder they are listed, FOLDER/NAME is one.
    """

    path: Annotated[tyro.conf.Positional[str], help_text(metavar="DATASET|RECORDING")]
    """Folder or URL of a dataset, or a recording."""
    reader: Annotated[str | None, help_text(default="recognised from the files", metavar="NAME|FILE.py:CLASS")] = None
    """Reader of the recording."""
    tz: Annotated[str | None, help_text(default="none", metavar="ZONE")] = None
    """Time zone of time stamps without one, such as Africa/Casablanca (csv reader)."""
    columns: Annotated[str | None, help_text(default="recognised from the header")] = None
    """Names of columns, such as time=Date+Time,lon=LON,lat=LAT (csv reader)."""
    option: Annotated[tuple[str, ...], tyro.conf.UseAppendAction, help_text(metavar="KEY=VALUE")] = ()
    """Another option of the reader."""
    json: bool = False
    """Print JSON."""


def main(argv: Sequence[str]) -> int:
    """Run the verb."""
    arguments = parse_arguments(Arguments, argv, "mirror info", examples=_EXAMPLES)
    path = Path(arguments.path)
    is_remote = is_url(arguments.path)
    if not is_remote and not path.exists() and not _is_drive_of_folder(path, arguments.reader):
        raise DatasetError("there is no file or folder at this path", file=path, expected="a dataset or a recording")
    if is_remote or (path / "dataset.json").is_file():
        from mirror.integrity.summary import summarise as summarise_dataset

        dataset = summarise_dataset(arguments.path)
        plain, lines = dataset.to_dict(), _dataset_lines(dataset)
        kind = "dataset"
    else:
        from mirror.recordings.boundary import reader_errors
        from mirror.recordings.protocol import ConfiguredReader
        from mirror.recordings.registry import find_reader, list_drives
        from mirror.recordings.summary import summarise as summarise_recording

        with reader_errors(path):
            drives = list_drives(path, arguments.reader) or []
        if len(drives) > 1:
            return _print_drives(path, drives, as_json=arguments.json)
        options = reader_options(arguments.option, tz=arguments.tz, columns=arguments.columns)
        with reader_errors(path):
            reader = find_reader(path, arguments.reader)
            if isinstance(reader, ConfiguredReader) and (text := reader.propose_configuration(path, options)):
                print(json.dumps({"path": str(path), "configuration": text}) if arguments.json else text.rstrip())
                return ExitCode.DONE
            recording = summarise_recording(reader.open(path, options))
        plain, lines = recording.to_dict(), _recording_lines(recording)
        kind = "recording"
    if arguments.json:
        print(json.dumps({"path": str(arguments.path), "kind": kind, **plain}))
        return ExitCode.DONE
    width = max(len(name) for name, _ in lines)
    print(f"{arguments.path} is a {kind}")
    for name, text in lines:
        print(f"  {name:<{width}}  {text}")
    return ExitCode.DONE


def _is_drive_of_folder(path: Path, reader: str | None) -> bool:
    from mirror.recordings.registry import is_drive_of_folder

    return is_drive_of_folder(path, reader)


def _print_drives(path: Path, drives: Sequence[Path], *, as_json: bool) -> int:
    """List the drives of a folder whose format keeps several in it."""
    names = [drive.relative_to(path).as_posix() for drive in drives]
    if as_json:
        print(json.dumps({"path": str(path), "kind": "drives", "drives": names}))
        return ExitCode.DONE
    print(f"{path} holds {count_of(len(names), 'drive')}")
    for name in names[:_LISTED]:
        print(f"  {name}")
    if len(names) > _LISTED:
        print(f"  ... and {len(names) - _LISTED} more")
    print(f"`mirror info {drives[0]}` describes one, `mirror ingest {path}` takes all.")
    return ExitCode.DONE


def _dataset_lines(summary: DatasetSummary) -> list[tuple[str, str]]:
    trigger = summary.document.trigger
    lines = [
        ("schema", summary.document.schema_version),
        ("licence", summary.document.licence or "not stated"),
        (
            "trigger",
            f"{trigger.min_duration_s:g} s and {trigger.min_path_m:g} m at least, {trigger.min_overlap:.0%} inside",
        ),
        ("scenes (traversals)", _numbered(summary.scenes)),
        ("drives", str(summary.drives)),
        ("vehicles (drives)", _numbered(summary.vehicles)),
        ("vehicle types (drives)", _numbered(summary.vehicle_types)),
        *((f"rig {name}", ", ".join(cameras)) for name, cameras in summary.rigs.items()),
        ("passes", _counts(summary.passes)),
        ("traversals", str(summary.traversals)),
        ("images", f"{summary.images:,} ({summary.image_bytes / 1e6:,.1f} MB)"),
        ("time", _dates(summary.first_ns, summary.last_ns, summary.hours)),
        ("layers (traversals)", _numbered(summary.layers)),
        *([("lidar sweeps", f"{summary.sweeps:,}")] if summary.sweeps else []),
        ("road maps (lanes)", _numbered(summary.road_maps)),
        *((f"split {name}", _counts(roles)) for name, roles in summary.splits.items()),
        ("index", summary.index if summary.index == "current" else f"{summary.index}: run `mirror index`"),
    ]
    if summary.problems:
        lines.append(
            (
                "unreadable",
                f"{count_of(len(summary.problems), 'file')}: run `mirror check`; the first: {summary.problems[0]}",
            )
        )
    return lines


def _recording_lines(summary: RecordingSummary) -> list[tuple[str, str]]:
    info = summary.info
    longitudes = summary.extent.get("longitude_deg") if info.has_date else None
    lines = [
        ("drive", info.drive_id + (" (a clip)" if info.is_clip else "")),
        ("vehicle", f"{info.vehicle_id} ({info.vehicle_type})"),
        ("frame", "WGS 84" if info.frame is None else f"local: {info.frame}"),
        ("body", info.body_frame),
        ("time base", info.time_base),
        ("metadata", ", ".join(f"{k}: {getattr(info, k) or '--'}" for k in ("city", "light", "weather", "licence"))),
        ("files", f"{summary.files:,} ({summary.bytes / 1e6:,.1f} MB)"),
        ("poses", f"{summary.poses:,} ({summary.usable:,} usable), with {', '.join(summary.has) or 'positions only'}"),
        ("time", _span(summary.first_ns, summary.last_ns, longitudes)),
        *((name, f"{low:.6f} to {high:.6f}") for name, (low, high) in summary.extent.items()),
        ("rig", f"{summary.rig_id}, reference {summary.reference_camera}" if summary.rig_id else "none: poses only"),
    ]
    lines += [("note", note) for note in info.notes]
    if summary.bad_rows:
        lines.append(("bad rows", f"{_counts(summary.bad_rows)}; the first: {summary.first_bad_row}"))
    for name, camera in summary.cameras.items():
        rate = f" at {camera.rate_hz:.1f} Hz" if camera.rate_hz else ""
        stages = _counts(camera.calibrations) if camera.is_calibrated else "none: the source declares it uncalibrated"
        missing = f", {camera.missing:,} missing in pauses" if camera.missing else ""
        repeated = ""
        if camera.repeated:
            repeated = f", {camera.repeated:,} left out with the stamp of another, first {camera.first_repeated_ns}"
        counts = f"{camera.images:,} {camera.codec}{rate}{missing}{repeated}"
        lines.append((f"camera {name}", f"{counts}; calibrations: {stages}"))
    lines.append(("boxes", f"{summary.boxes:,}" if summary.boxes else "none"))
    if summary.sweeps:
        lines.append(("lidar sweeps", f"{summary.sweeps:,}"))
    return lines


def _counts(counts: Mapping[str, int]) -> str:
    listed = [f"{name} {count}" for name, count in list(counts.items())[:_LISTED]]
    more = f" and {len(counts) - _LISTED} more" if len(counts) > _LISTED else ""
    return ", ".join(listed) + more if counts else "none"


def _numbered(counts: Mapping[str, int]) -> str:
    return f"{len(counts)}: {_counts(counts)}" if counts else "none"


def _dates(first_ns: int | None, last_ns: int | None, hours: float) -> str:
    if first_ns is None or last_ns is None:
        return "--"
    from datetime import UTC, datetime

    first, last = (datetime.fromtimestamp(stamp / 1e9, UTC) for stamp in (first_ns, last_ns))
    return f"{first:%Y-%m-%d} to {last:%Y-%m-%d}, {hours:.2f} hours of traversals"


def _span(first_ns: int | None, last_ns: int | None, longitudes_deg: tuple[float, float] | None) -> str:
    if first_ns is None or last_ns is None:
        return "--"
    from datetime import UTC, datetime

    first, last = (datetime.fromtimestamp(stamp / 1e9, UTC) for stamp in (first_ns, last_ns))
    from mirror.dataset.times import solar_time

    local = "" if longitudes_deg is None else f"; from {solar_time(first_ns, longitudes_deg[0])} solar time"
    length = f"{(last_ns - first_ns) * 1e-9:,.1f} s"
    return f"{first:%Y-%m-%d %H:%M:%S} to {last:%Y-%m-%d %H:%M:%S} UTC ({length}{local})"
