"""One accepted pass written as a traversal: poses, images, calibrations, recorded boxes; its manifest last."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from mirror.arrays import Int64
from mirror.dataset.images.shards import pack_images
from mirror.dataset.layout import Layout, complete_manifest, is_intact, seal
from mirror.errors import RecordingError, SchemaError
from mirror.ingest.images import PlacedImages, Transfer, place_images, refer_to_images
from mirror.ingest.lidars import write_lidars
from mirror.ingest.passes import DrivePasses
from mirror.ingest.references import References
from mirror.ingest.refusals import refuse_invalid_boxes, refuse_other_image_sizes, refuse_other_mask_size
from mirror.ingest.staging import Staging
from mirror.ingest.tables import assign_frames, build_pose_table
from mirror.ingest.trigger import Pass
from mirror.ingest.videos import place_videos
from mirror.recordings.boundary import reader_errors
from mirror.recordings.calibration import require_covariance
from mirror.recordings.pauses import count_missing_images
from mirror.recordings.protocol import ImageStream, ReferencedStream, repeated_stamps
from mirror.recordings.video import CompressedStream
from mirror.schema.documents import ImageTotals, Roi, is_identifier
from mirror.schema.files import conform, encode_json, encode_table, read_table, write_bytes
from mirror.schema.references import REFERENCES, ImageReferences
from mirror.schema.tables import BOXES, CALIBRATIONS, EGO_POSES, IMAGES, Table


@dataclass(frozen=True)
class WriteOptions:
    """Options of writing traversals.

    Attributes:
        transfer: hard links where possible, or copies.
        hashing: read and hash every image.
        decoding: decode every image.
        videos: what becomes of the frames of a recorded video: images, or the compressed video of the stretch.
        shards: put images side by side into tar archives, frame by frame, instead of a file each.
        references: what is kept of images that the recording refers to by uri.
    """

    transfer: Transfer = "link"
    hashing: bool = True
    decoding: bool = False
    videos: Literal["jpeg", "video"] = "jpeg"
    shards: bool = False
    references: References = "size"


@dataclass(frozen=True)
class WriteReport:
    """The counts of a written traversal.

    Attributes:
        traversal_id: the traversal.
        images: images in it.
        bytes: of the images.
        linked: images that are hard links.
        reused: it was complete already, and nothing was done.
        without_pose: images exposed within the pass that were left out, as they were taken in a gap of the poses.
        missing: images that the recording lacks within the pass, by the pauses of its cameras.
        repeated: by camera, images within the pass that were left out, as another one has the same stamp.
    """

    traversal_id: str
    images: int
    bytes: int
    linked: int
    reused: bool
    without_pose: int = 0
    missing: int = 0
    repeated: Mapping[str, int] = field(default_factory=dict)


def traversal_id(drive_id: str, one: Pass) -> str:
    """Make the id of a traversal: ``scene.drive.entry_ms``."""
    return f"{one.scene_id}.{drive_id}.{one.entry_ns // 1_000_000}"


def write_traversal(
    staging: Staging,
    drive: DrivePasses,
    number: int,
    roi: Roi,
    configuration: str,
    options: WriteOptions,
    threads: int,
    advance: Callable[[int], None],
    *,
    replace: bool = False,
) -> WriteReport:
    """Write one accepted pass, unless it is complete already.

    Attempts at the same traversal do not meet: each writes a folder of its own, and the first that is complete stays.

    Args:
        staging: takes the traversal when it is complete.
        drive: judged.
        number: of the pass in ``drive.passes``.
        roi: its scene.
        configuration: hash of the options that decide what is written.
        options: how.
        threads: how many cameras are written at a time.
        advance: called with the number of images done since the last call, from those threads.
        replace: write it, also where the dataset has it.

    Raises:
        RecordingError: something in the recording cannot be used; nothing is left of this attempt.
        DatasetError: the folder cannot be written.
    """
    one = drive.passes[number]
    name = traversal_id(drive.info.drive_id, one)
    derived_from = {
        "source": drive.source.fingerprint,
        "configuration": configuration,
        "scene": hashlib.sha256(roi.model_dump_json().encode()).hexdigest(),
    }
    for layout in (staging.layout, *(() if replace else (staging.dataset,))):
        folder = layout.recorded(name)
        manifest = complete_manifest(folder)
        if manifest is not None and manifest.derived_from == derived_from and is_intact(folder):
            if layout is staging.layout and not _has_source_bytes(folder, drive, number):
                # A killed run made it of other bytes, behind equal sizes and times.
                shutil.rmtree(layout.traversal(name))
                continue
            images = manifest.pictures or ImageTotals(count=0, bytes=0)
            advance(images.count)
            written = WriteReport(name, images.count, images.bytes, 0, reused=True)
            return _with_lost_images(written, drive, number)
    with staging.attempt() as attempt:
        with reader_errors(drive.path):
            written = _write(attempt, name, drive, number, roi, derived_from, options, threads, advance)
        staging.complete(attempt, name)
    return written


def _has_source_bytes(folder: Path, drive: DrivePasses, number: int) -> bool:
    """Return whether the images of a complete traversal have the bytes of the recording's; videos are not compared."""
    wanted = ["camera", "exposure_start_ns", "sha256"]
    rows = read_table(folder / "images.parquet", IMAGES, wanted).to_pylist()
    written = {(row["camera"], row["exposure_start_ns"]): row["sha256"] for row in rows}
    for camera, (stream, indices, _) in select_images(drive, number).items():
        for index in indices.tolist():
            path = stream.path(index)
            sha256 = written.get((camera, int(stream.exposure_start_ns[index])))
            if path is None or sha256 is None:
                continue
            try:
                if hashlib.sha256(Path(path).read_bytes()).digest() != sha256:
                    return False
            except OSError:
                # Writing it again names the file.
                return False
    return True


def _write(
    layout: Layout,
    name: str,
    drive: DrivePasses,
    number: int,
    roi: Roi,
    derived_from: dict[str, str],
    options: WriteOptions,
    threads: int,
    advance: Callable[[int], None],
) -> WriteReport:
    one, folder = drive.passes[number], layout.recorded(name)
    streams = select_images(drive, number)
    _write_boxes(layout, name, drive, one, derived_from)
    write_lidars(layout, name, drive, one, derived_from)

    def place(stream: ImageStream, indices: Int64, stamps: Int64, folder: Path) -> PlacedImages:
        if isinstance(stream, ReferencedStream):
            return refer_to_images(stream, indices, advance, options.references)
        if options.videos == "video" and isinstance(stream, CompressedStream):
            return place_videos(
                stream,
                indices,
                stamps,
                folder,
                hashing=options.hashing,
                decoding=options.decoding,
                advance=advance,
            )
        return place_images(
            stream,
            indices,
            stamps,
            folder,
            transfer=options.transfer,
            hashing=options.hashing,
            decoding=options.decoding,
            advance=advance,
        )

    with ThreadPoolExecutor(threads) as pool:
        futures = {
            camera: pool.submit(place, stream, indices, stamps, folder / camera)
            for camera, (stream, indices, stamps) in streams.items()
        }
        try:
            placed = {camera: future.result() for camera, future in futures.items()}
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    calibrations, rig = _calibration_table(drive), drive.recording.rig
    masks = {} if rig is None else {one.name: one.static_mask for one in rig.cameras}
    for camera, (stream, indices, _) in streams.items():
        here = placed[camera]
        sources = [str(stream.path(index) or stored) for index, stored in zip(indices.tolist(), here.names)]
        refuse_other_image_sizes(camera, here.width_px, here.height_px, sources, calibrations)
        if (mask := masks.get(camera)) is not None:
            refuse_other_mask_size(camera, mask, here.width_px, here.height_px, sources)
    images = _image_table(name, drive, streams, placed)
    if options.shards and images.num_rows:
        images = pack_images(images, layout.root, f"traversals/{name}/recorded")
    tables: list[tuple[Table, pa.Table]] = [
        (EGO_POSES, build_pose_table(drive.slices[number], roi, drive)),
        (IMAGES, images),
        (CALIBRATIONS, calibrations),
    ]
    files: dict[str, bytes] = {}
    for table, rows in tables:
        files[f"{table.name}.parquet"] = encode_table(rows, table)
        write_bytes(folder / f"{table.name}.parquet", files[f"{table.name}.parquet"])
    etags = {uri: etag for one_camera in placed.values() for uri, etag in one_camera.etags.items()}
    if etags:
        files[REFERENCES] = encode_json(ImageReferences(etags=dict(sorted(etags.items()))))
        write_bytes(folder / REFERENCES, files[REFERENCES])
    count = sum(len(one_camera.names) for one_camera in placed.values())
    total = sum(one_camera.bytes for one_camera in placed.values())
    seal(folder, files, derived_from=derived_from, images=ImageTotals(count=count, bytes=total))
    linked = 0 if options.shards else sum(one_camera.linked for one_camera in placed.values())
    return _with_lost_images(WriteReport(name, count, total, linked, reused=False), drive, number)


def select_images(drive: DrivePasses, number: int) -> dict[str, tuple[ImageStream, Int64, Int64]]:
    """Select by camera, in order of name, the images of a pass: stream, indices of the images, and stamps.

    Taken are the images exposed within the pass at an instant at which the vehicle's pose is known
    (`PoseSlice.poses_known`).

    Args:
        drive: judged.
        number: of the accepted pass in ``drive.passes``.

    Raises:
        RecordingError: stamps repeat or run backward, or a camera's stamps and the poses do not overlap at all.
    """
    chosen: dict[str, tuple[ImageStream, Int64, Int64]] = {}
    for camera, (stream, inside, stamps) in _exposed_within(drive, drive.passes[number]).items():
        known = drive.slices[number].poses_known(stamps)
        if known.any():
            chosen[camera] = (stream, inside[known], stamps[known])
    return chosen


def images_without_pose(drive: DrivePasses, number: int) -> int:
    """Count the images of all cameras that were exposed within an accepted pass but in a gap of the poses.

    Args:
        drive: judged.
        number: of the accepted pass in ``drive.passes``.

    Raises:
        RecordingError: as `select_images`.
    """
    poses = drive.slices[number]
    exposed = _exposed_within(drive, drive.passes[number]).values()
    return sum(int(np.count_nonzero(~poses.poses_known(stamps))) for _, _, stamps in exposed)


def repeated_images(drive: DrivePasses, number: int) -> dict[str, int]:
    """Count, by camera, the images within an accepted pass that a stream leaves out because their stamp is repeated.

    Args:
        drive: judged.
        number: of the accepted pass in ``drive.passes``.
    """
    one, found = drive.passes[number], {}
    for camera, stream in sorted(drive.content.images().items()):
        stamps = repeated_stamps(stream)
        if count := int(np.count_nonzero((stamps >= one.entry_ns) & (stamps <= one.exit_ns))):
            found[camera] = count
    return found


def _with_lost_images(written: WriteReport, drive: DrivePasses, number: int) -> WriteReport:
    """Count the images that the pass lacks: without a pose, missing from the recording, and with repeated stamps."""
    exposed = _exposed_within(drive, drive.passes[number]).values()
    missing = sum(count_missing_images(stamps) for _, _, stamps in exposed)
    without_pose, repeated = images_without_pose(drive, number), repeated_images(drive, number)
    return replace(written, without_pose=without_pose, missing=missing, repeated=repeated)


def _exposed_within(drive: DrivePasses, one: Pass) -> dict[str, tuple[ImageStream, Int64, Int64]]:
    """By camera, in order of name: its stream, the indices of the images exposed within a pass, and their stamps."""
    chosen: dict[str, tuple[ImageStream, Int64, Int64]] = {}
    for camera, stream in sorted(drive.content.images().items()):
        if not is_identifier(camera):
            raise RecordingError(
                f"camera name {camera!r} cannot be a folder",
                file=drive.path,
                expected="letters, digits, _ and -",
                remedy="rename the camera in the recording",
            )
        stamps = stream.exposure_start_ns + (stream.exposure_end_ns - stream.exposure_start_ns) // 2
        wrong = np.flatnonzero(np.diff(stamps) <= 0)
        if len(wrong):
            row = int(wrong[0]) + 1
            raise RecordingError(
                f"image {row} at {stamps[row]} ns is not later than the one before it at {stamps[row - 1]} ns",
                file=stream.path(row) or drive.path,
                place=f"camera {camera}",
                expected="strictly increasing exposure stamps",
                remedy="correct the stamps, or take the repeated images out of the recording",
            )
        if len(stamps) and (stamps[-1] < drive.start_ns or stamps[0] > drive.end_ns):
            raise RecordingError(
                f"images run from {stamps[0]} to {stamps[-1]} ns, poses from {drive.start_ns} to {drive.end_ns} ns:"
                " no pose covers any image",
                file=drive.path,
                place=f"camera {camera}",
                expected="one clock for images and poses",
                remedy="correct the camera's stamps or its time offset in the calibration",
            )
        inside = np.flatnonzero((stamps >= one.entry_ns) & (stamps <= one.exit_ns))
        if len(inside):
            chosen[camera] = (stream, inside, stamps[inside])
    return chosen


def _image_table(
    name: str,
    drive: DrivePasses,
    streams: dict[str, tuple[ImageStream, Int64, Int64]],
    placed: dict[str, PlacedImages],
) -> pa.Table:
    rig = drive.recording.rig
    frames = assign_frames(
        {camera: stamps for camera, (_, _, stamps) in streams.items()}, rig.reference_camera if rig else ""
    )
    parts = []
    for camera, (stream, indices, stamps) in streams.items():
        here, count = placed[camera], len(stamps)
        folder = f"traversals/{name}/recorded/{camera}/"
        parts.append(
            pa.table(
                {
                    "camera": pa.array([camera] * count, pa.string()),
                    "timestamp_ns": stamps,
                    "exposure_start_ns": stream.exposure_start_ns[indices],
                    "exposure_end_ns": stream.exposure_end_ns[indices],
                    "frame_index": pa.array(frames[camera], pa.int32()),
                    "width_px": here.width_px.astype(np.int32),
                    "height_px": here.height_px.astype(np.int32),
                    "uri": [name if "://" in name else folder + name for name in here.names],
                    "byte_offset": np.zeros(count, np.int64),
                    "byte_length": np.array(here.sizes, np.int64),
                    "codec": pa.array([here.codec] * count, pa.string()),
                    "video_pts": pa.nulls(count, pa.int64()) if here.video_pts is None else here.video_pts,
                    "sha256": pa.array(here.sha256, pa.binary(32)),
                    "privacy": pa.array(["raw"] * count, pa.string()),
                }
            )
        )
    if not parts:
        return IMAGES.schema.empty_table()
    return _conform_rows(pa.concat_tables(parts), IMAGES, drive)


def _calibration_table(drive: DrivePasses) -> pa.Table:
    rows = drive.content.calibrations()
    if not rows.num_rows:
        return CALIBRATIONS.schema.empty_table()
    rows = _conform_rows(rows, CALIBRATIONS, drive)
    _require_covariances(rows, drive)
    plain = {name: rows.column(name).cast(pa.string()) for name in ("camera", "stage")}
    keys = pa.table({**plain, "valid_from_ns": rows.column("valid_from_ns")})
    order = pc.sort_indices(keys, [(key, "ascending") for key in CALIBRATIONS.sorted_by])
    return rows.take(order).combine_chunks()


def _conform_rows(rows: pa.Table, table: Table, drive: DrivePasses) -> pa.Table:
    """Cast rows that a reader gave to a table's schema."""
    try:
        return conform(rows, table, file=drive.path)
    except SchemaError as error:
        raise RecordingError(
            error.problem,
            file=error.file,
            place=error.place,
            expected=error.expected,
            remedy=f"mend the reader: docs/schema.md has the columns of the table {table.name}",
        ) from error


def _require_covariances(rows: pa.Table, drive: DrivePasses) -> None:
    for row, values in enumerate(rows.column("covariance").to_pylist()):
        try:
            if values is not None:
                require_covariance(np.array(values, np.float64))
        except ValueError as error:
            raise RecordingError(
                str(error),
                file=drive.path,
                place=f"calibration {row}, camera {rows.column('camera')[row].as_py()}",
                expected="6x6 numbers, row-major, symmetric and positive semi-definite",
                remedy="correct the covariance, or leave it out",
            ) from error


def _write_boxes(layout: Layout, name: str, drive: DrivePasses, one: Pass, derived_from: dict[str, str]) -> None:
    """Boxes that came with the recording, as layers by their source and version."""
    boxes = drive.content.boxes()
    if boxes is None:
        return
    boxes = _conform_rows(boxes, BOXES, drive)
    refuse_invalid_boxes(boxes, drive.path)
    stamps = boxes.column("timestamp_ns")
    boxes = boxes.filter(pc.and_(pc.greater_equal(stamps, one.entry_ns), pc.less_equal(stamps, one.exit_ns)))
    origin = pa.table({key: boxes.column(key).cast(pa.string()) for key in ("source", "source_version")})
    for source, version in sorted({tuple(row.values()) for row in origin.to_pylist()}):
        if not (is_identifier(source) and is_identifier(version.replace(".", "_"))):
            raise RecordingError(
                f"box source {source}@{version} cannot be a folder",
                file=drive.path,
                expected="letters, digits, _, - and .",
            )
        mine = pc.and_(pc.equal(origin.column("source"), source), pc.equal(origin.column("source_version"), version))
        rows = boxes.filter(mine)
        keys = pa.table({key: rows.column(key) for key in BOXES.sorted_by})
        order = pc.sort_indices(keys, [(key, "ascending") for key in BOXES.sorted_by])
        data = encode_table(rows.take(order), BOXES)
        folder = layout.layer(name, "boxes", source, version)
        write_bytes(folder / "boxes.parquet", data)
        seal(folder, {"boxes.parquet": data}, derived_from=derived_from)
