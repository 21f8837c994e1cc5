"""What stands once a drive: its rig, its document and ledger, and the check of its source."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

from mirror.dataset.images.binary_mask import encode_mask
from mirror.dataset.layout import Layout, complete_manifest, is_intact, manifest_sha256, seal
from mirror.errors import RecordingError
from mirror.ingest.passes import DrivePasses
from mirror.ingest.staging import Staging
from mirror.ingest.tables import build_pass_table
from mirror.ingest.traversal import images_without_pose, repeated_images, traversal_id
from mirror.ingest.weather import weather_from_traversals
from mirror.recordings.boundary import reader_errors
from mirror.recordings.protocol import Recording, RigInfo
from mirror.schema.documents import DriveDocument, Rig, RigCamera
from mirror.schema.files import encode_table, read_json, read_table, write_bytes, write_json
from mirror.schema.tables import IMAGES, PASSES


def make_rig_document(recording: Recording) -> Rig | None:
    """Make ``rigs/<rig_id>.json`` of a recording; None for one with poses only."""
    rig = recording.rig
    if rig is None:
        return None
    cameras = tuple(
        RigCamera(
            name=camera.name,
            source_name=camera.source_name,
            static_mask=mask_file_name(rig.rig_id, camera.name) if camera.static_mask is not None else None,
        )
        for camera in rig.cameras
    )
    return Rig(
        rig_id=rig.rig_id,
        vehicle_type=recording.info.vehicle_type,
        reference_camera=rig.reference_camera,
        cameras=cameras,
    )


def uncalibrated_cameras(rig: RigInfo | None) -> tuple[str, ...]:
    """Return the names of the cameras that have no calibration, according to the source."""
    return () if rig is None else tuple(camera.name for camera in rig.cameras if not camera.is_calibrated)


def refuse_conflicting_rig(layout: Layout, drive: DrivePasses, seen: dict[str, Rig]) -> None:
    """Refuse a rig whose id another rig has, in the dataset or in this run.

    Args:
        layout: the dataset.
        drive: judged.
        seen: rigs of this run by id; the drive's is added.

    Raises:
        RecordingError: cameras, reference camera or vehicle type differ.
    """
    document = make_rig_document(drive.recording)
    if document is None:
        return
    path = layout.rig(document.rig_id)
    if document.rig_id not in seen:
        seen[document.rig_id] = read_json(path, Rig) if path.exists() else document
    if seen[document.rig_id] != document:
        raise conflicting_rig_error(drive.path, document.rig_id)


def conflicting_rig_error(path: Path, rig_id: str) -> RecordingError:
    """Make the error for a recording whose rig has the id of another rig."""
    return RecordingError(
        f"rig {rig_id!r} is known with other cameras, another reference camera or vehicle type",
        file=path,
        expected=f"the rig of {rig_id}.json",
        remedy="give the rig of this recording another id",
    )


def refuse_owned_id(path: Path, drive_id: str, owners: dict[str, Path]) -> None:
    """Refuse a recording whose drive id another recording of the run has.

    Args:
        path: the recording.
        drive_id: its drive id.
        owners: recordings of the run by drive id; this one is added.

    Raises:
        RecordingError: another one has it.
    """
    if drive_id in owners:
        raise RecordingError(
            f"drive id {drive_id!r} is also that of {owners[drive_id]}",
            file=path,
            expected="one recording a drive id",
            remedy="give one of them another id; ingest the files of one drive as one recording",
        )
    owners[drive_id] = path


def _write_rig(staging: Staging, drive: DrivePasses) -> None:
    document, rig, layout = make_rig_document(drive.recording), drive.recording.rig, staging.layout
    if document is None or rig is None or staging.dataset.rig(document.rig_id).exists():
        return
    for camera in rig.cameras:
        if camera.static_mask is not None:
            encoded = encode_mask(camera.static_mask)
            write_bytes(layout.root / "rigs" / mask_file_name(rig.rig_id, camera.name), encoded)
    write_json(layout.rig(document.rig_id), document)


def mask_file_name(rig_id: str, camera: str) -> str:
    """Return the name of a camera's static mask in the folder of rigs."""
    return f"{rig_id}.{camera}.png"


def seal_drive(
    staging: Staging, drive: DrivePasses, scenes: Sequence[str], configuration: str, weather_plugin: str | None
) -> None:
    """Write the drive's document and ledger, then its manifest: the drive is complete, and `Staging.publish` takes it.

    Args:
        staging: with the drive's traversals, where the dataset does not have them.
        drive: judged.
        scenes: all scenes that it was judged for.
        configuration: hash of the options that decide what is written.
        weather_plugin: tells the weather where the source does not.
    """
    info = drive.info
    names = [traversal_id(info.drive_id, one) if one.accepted else None for one in drive.passes]
    _write_rig(staging, drive)
    with reader_errors(drive.path):
        rig = drive.recording.rig
        document = DriveDocument(
            drive_id=info.drive_id,
            vehicle_id=info.vehicle_id,
            vehicle_type=info.vehicle_type,
            rig_id=rig.rig_id if rig else None,
            source=drive.source,
            configuration=configuration,
            scenes=tuple(sorted(scenes)),
            frame=info.frame,
            time_base=info.time_base,
            body_frame=info.body_frame,
            is_clip=info.is_clip,
            city=info.city,
            start_ns=drive.start_ns,
            end_ns=drive.end_ns,
            cleaning=drive.cleaning,
            images_without_pose=sum(images_without_pose(drive, number) for number in drive.slices),
            images_repeated=sum(sum(repeated_images(drive, number).values()) for number in drive.slices),
            has_date=info.has_date,
            has_motion=info.has_motion,
            uncalibrated_cameras=uncalibrated_cameras(rig),
        )
    weather = weather_from_traversals(staging, drive, names, weather_plugin) if weather_plugin else {}
    ledger = encode_table(build_pass_table(drive, names, weather, weather_plugin), PASSES)
    folder = staging.layout.drive(info.drive_id)
    write_json(folder / "drive.json", document)
    write_bytes(folder / "passes.parquet", ledger)
    derived_from = {f"traversal:{name}": manifest_sha256(staging.recorded(name)) for name in names if name is not None}
    derived_from["source"] = drive.source.fingerprint
    derived_from["configuration"] = configuration
    seal(
        folder,
        {"drive.json": (folder / "drive.json").read_bytes(), "passes.parquet": ledger},
        derived_from=derived_from,
    )


def are_traversals_intact(layout: Layout, drive_id: str) -> bool:
    """Return whether every traversal of a complete drive is unchanged since it was sealed, images aside."""
    manifest = complete_manifest(layout.drive(drive_id))
    if manifest is None:
        return False
    prefix = "traversal:"
    return all(
        is_intact(folder) and manifest_sha256(folder) == sha256
        for key, sha256 in manifest.derived_from.items()
        if key.startswith(prefix)
        for folder in [layout.recorded(key.removeprefix(prefix))]
    )


def verify_source(layout: Layout, recording: Recording, drive_id: str) -> None:
    """Hash the images of a drive's traversals again, at their source.

    Raises:
        RecordingError: an image's bytes differ from those ingested though its size and time do not, or the recording
            has it no more.
    """
    sources = {
        (camera, int(stream.exposure_start_ns[index])): stream.path(index)
        for camera, stream in recording.images().items()
        for index in range(len(stream.exposure_start_ns))
    }
    ledger = read_table(layout.drive(drive_id) / "passes.parquet", PASSES, ["traversal_id"])
    for name in ledger.column("traversal_id").to_pylist():
        if name is None:
            continue
        wanted = ["camera", "exposure_start_ns", "uri", "sha256"]
        for row in read_table(layout.recorded(name) / "images.parquet", IMAGES, wanted).to_pylist():
            source = sources.get((row["camera"], row["exposure_start_ns"]), layout.root / "missing")
            if source is None or row["sha256"] is None:
                continue
            try:
                data = Path(source).read_bytes()
            except OSError as error:
                raise RecordingError(
                    "the image has no counterpart in the recording any more",
                    file=layout.root / row["uri"],
                    remedy="restore the recording, or ingest it again with --replace",
                ) from error
            if hashlib.sha256(data).digest() != row["sha256"]:
                raise RecordingError(
                    "the image's bytes have changed since it was ingested",
                    file=source,
                    expected="the SHA-256 of its row in the images table",
                    remedy="restore the recording, or ingest it again with --replace",
                )
