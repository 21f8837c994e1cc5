"""Sweeps of lidars in exports: the files of the source under new names, linked where possible, else copied."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from mirror.dataset.lidars import LidarFiles
from mirror.errors import DatasetError
from mirror.export.scene import ExportScene
from mirror.geometry.poses import Poses
from mirror.schema.files import unwritable_error, write_bytes


@dataclass(frozen=True, eq=False)
class Sweep:
    """One sweep.

    Attributes:
        sensor: the source's name of the lidar.
        format: format of its file.
        timestamp_ns: Unix time.
        uri: absolute path or URL of its file.
        ego_SE3_sensor: its pose.
    """

    sensor: str
    format: str
    timestamp_ns: int
    uri: str
    ego_SE3_sensor: Poses


@dataclass(frozen=True, eq=False)
class SweepFiles:
    """The sweeps that a format has a place for.

    Attributes:
        places: sweeps by the path of their file below the export's folder.
        notes: what is left out, in words.
    """

    places: Mapping[str, Sweep]
    notes: tuple[str, ...] = ()


def list_sweeps(scene: ExportScene) -> dict[str, list[Sweep]]:
    """Return the sweeps of each traversal that has any, by sensor and time; missing files included."""
    found = {}
    for traversal_id, frames in scene.by_traversal():
        sweeps = sorted(
            (one for files in frames[0][0].lidars for one in _sweeps_of(files)),
            key=lambda one: (one.sensor, one.timestamp_ns),
        )
        if sweeps:
            found[traversal_id] = sweeps
    return found


def present_sweeps(sweeps: Mapping[str, list[Sweep]]) -> tuple[dict[str, list[Sweep]], tuple[str, ...]]:
    """Leave out the sweeps whose files are not at their place; those behind a URL are not asked for.

    Returns:
        The others by traversal, and a note if any is left out.
    """
    kept = {key: [one for one in every if "://" in one.uri or Path(one.uri).is_file()] for key, every in sweeps.items()}
    total, there = (sum(map(len, some.values())) for some in (sweeps, kept))
    note = f"{total - there} of {total} lidar sweeps are left out: their files are not at their place"
    return kept, (note,) if there < total else ()


def _sweeps_of(files: LidarFiles) -> Iterator[Sweep]:
    for row, (stamp, uri) in enumerate(zip(files.timestamp_ns.tolist(), files.uris)):
        yield Sweep(files.sensor, files.format, stamp, uri, files.ego_SE3_sensor[row : row + 1])


def place_sweep(sweep: Sweep, target: Path, *, copy: bool) -> None:
    """Link or copy the file of a sweep.

    Args:
        sweep: the sweep.
        target: file to write.
        copy: never make a hard link.

    Raises:
        DatasetError: the file cannot be read or written.
    """
    if "://" in sweep.uri:
        write_bytes(target, _fetch(sweep.uri))
        return
    source = Path(sweep.uri)
    if not (target.is_file() and target.samefile(source)) and (copy or not _link(source, target)):
        try:
            write_bytes(target, source.read_bytes())
        except OSError as error:
            raise DatasetError(f"cannot be read: {error.strerror or error}", file=source) from error


def _link(source: Path, target: Path) -> bool:
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable_error(target, error) from error
    try:
        temporary.unlink(missing_ok=True)
        os.link(source.resolve(), temporary)
        temporary.replace(target)
    except OSError:
        return False
    finally:
        temporary.unlink(missing_ok=True)
    return True


def _fetch(uri: str) -> bytes:
    import fsspec

    try:
        filesystem, path = fsspec.core.url_to_fs(uri)
        return bytes(filesystem.cat_file(path))
    except (OSError, ImportError, ValueError) as error:
        raise DatasetError(
            f"cannot be fetched: {error}",
            file=uri,
            expected="a file that fsspec reads with the packages installed here",
        ) from error
