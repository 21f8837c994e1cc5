"""Writes drives as recordings in the `folder` layout (docs/recordings.md), with the errors that a fleet's have."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa

from mirror.arrays import AnyArray, Float64, Int64
from mirror.errors import UsageError
from mirror.geometry import Poses, heading_deg, matrix_from_quaternion, quaternion_from_matrix
from mirror.ingest.request import Progress, Silent
from mirror.recordings.time import GPS_EPOCH_NS
from mirror.schema.documents import CANONICAL_CAMERAS, Roi
from mirror.schema.files import write_bytes, write_json, write_table
from mirror.schema.tables import BOXES
from mirror.synth.fleet import SynthDrive, drives_of
from mirror.synth.presets import Preset
from mirror.version import __version__

if TYPE_CHECKING:
    from mirror.synth.render.casting import Lens

SOURCE: Final = "synth"
LICENCE: Final = "CC0-1.0"
FIX_SIGMA_M: Final = 0.03
_ANGLE_SIGMA_DEG: Final = 0.02
_LEAP_SECONDS: Final = 18
_JPEG_QUALITY: Final = 90
_BOX_SHARE: Final = 8e-5
_SETTLED_S: Final = 0.3


def write_recordings(
    out: Path,
    preset: str = "tiny",
    seed: int = 0,
    *,
    scenes: int | None = None,
    traversals: int | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> list[Path]:
    """Write the recordings of a preset, and ``rois.geojson`` beside them.

    The files depend on the arguments alone, not on the number of workers. ``recording.json`` is written last.

    Args:
        out: an empty folder, or one to be made.
        preset: ``tiny``, ``quick`` or ``demo``.
        seed: of everything that is left to chance.
        scenes: how many scenes; default: all that the preset has.
        traversals: how many drives with pictures through each; default: the preset's.
        workers: threads; default: as many as there are processors.
        progress: is told of every picture; None: nobody is.

    Returns:
        The recordings' folders.

    Raises:
        UsageError: no such preset, or the folder is not empty.
        DatasetError: the folder is not writable, or the disk is full.
    """
    settings, drives = drives_of(preset, seed, scenes, traversals)
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise UsageError("not an empty folder", file=out, remedy="name another folder, or remove this one")
    total = sum(len(_instants(drive, settings)) * len(CANONICAL_CAMERAS) for drive in drives if drive.recipe.pictures)
    progress = Silent() if progress is None else progress
    progress.start("pictures", total)
    write_json(out / "rois.geojson", _geojson([drive.world.roi for drive in drives]))
    with ThreadPoolExecutor(workers or os.cpu_count() or 1) as pool:
        for drive in drives:
            folder = out / drive.drive_id
            _write_poses(folder, drive, settings)
            if drive.recipe.pictures:
                for count in _write_pictures(folder, drive, settings, pool):
                    progress.advance(count)
            write_json(folder / "recording.json", _document(drive))
            # Each drive's shadow map is large, and no longer needed.
            vars(drive).pop("stage", None)
    return [out / drive.drive_id for drive in drives]


def _geojson(rois: Sequence[Roi]) -> dict[str, object]:
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [roi.longitude_deg, roi.latitude_deg]},
            "properties": roi.model_dump(mode="json", exclude_none=True),
        }
        for roi in {roi.scene_id: roi for roi in rois}.values()
    ]
    return {"type": "FeatureCollection", "features": features}


def _document(drive: SynthDrive) -> dict[str, object]:
    pictures = drive.recipe.pictures
    document: dict[str, object] = {
        "format": "mirror-folder",
        "version": "1.0",
        "drive_id": drive.drive_id,
        "vehicle_id": drive.vehicle.vehicle_id,
        "vehicle_type": drive.vehicle.kind.name,
        "rig_id": drive.vehicle.kind.rig_id if pictures else None,
        "time_base": "gps_us" if drive.recipe.poses == "gps" else "unix_ns",
        "frame": {"kind": "wgs84"},
        "body_frame": "ego",
        "city": drive.world.roi.city,
        "weather": drive.recipe.weather,
        "licence": LICENCE,
    }
    if pictures:
        document["reference_camera"] = CANONICAL_CAMERAS[0]
        document["cameras"] = {
            name: {"static_mask": f"masks/{name}.png" if name in drive.own_masks else None}
            for name in CANONICAL_CAMERAS
        }
    return document


def _write_poses(folder: Path, drive: SynthDrive, settings: Preset) -> None:
    """Poses with the errors of a good receiver: slow drift and a little noise, each fix on its own."""
    rng = np.random.default_rng([drive.seed, 1])
    time_s = np.arange(0.0, drive.truth.duration_s, 1.0 / settings.pose_hz)
    timestamp_ns = drive.condition.start_ns + np.round(time_s * 1e9).astype(np.int64)
    truth = drive.truth.poses(time_s)
    slow = np.linspace(0.0, time_s[-1], max(int(time_s[-1] / 4.0), 2))
    drift = np.stack([np.interp(time_s, slow, rng.normal(0, FIX_SIGMA_M, len(slow))) for _ in range(3)], axis=1)
    measured = truth.translation + drift + rng.normal(0, 0.1 * FIX_SIGMA_M, drift.shape)
    longitude, latitude, height = drive.frame.to_geodetic(measured)
    turned = truth @ Poses.exp(
        np.concatenate([rng.normal(0, np.radians(_ANGLE_SIGMA_DEG), drift.shape), np.zeros_like(drift)], axis=1)
    )
    enu_R_world = np.swapaxes(drive.frame.world_R_enu(longitude, latitude), 1, 2)
    rotation = quaternion_from_matrix(enu_R_world @ matrix_from_quaternion(turned.rotation))
    style = drive.recipe.poses
    columns: dict[str, AnyArray] = {"timestamp_ns": timestamp_ns}
    if style == "gps":
        gps_ns = timestamp_ns - GPS_EPOCH_NS + _LEAP_SECONDS * 1_000_000_000
        columns = {"timestamp": gps_ns // 1000}
    columns |= {"longitude_deg": longitude, "latitude_deg": latitude}
    if style == "heading":
        columns["heading_deg"] = heading_deg(rotation)
    else:
        columns["height_m"] = height
        columns |= {name: rotation[:, axis] for axis, name in enumerate(("qw", "qx", "qy", "qz"))}
    columns["sigma_m"] = np.full(len(time_s), FIX_SIGMA_M)
    table = pa.table(columns)
    if style == "parquet":
        import pyarrow.parquet as pq

        folder.mkdir(parents=True, exist_ok=True)
        pq.write_table(table, folder / "poses.parquet")
    elif style == "parts":
        length = -(-table.num_rows // 3)
        for part in range(3):
            _write_csv(folder / "poses" / f"part-{part}.csv", table.slice(part * length, length))
    else:
        _write_csv(folder / "poses.csv", table)


def _write_csv(path: Path, table: pa.Table) -> None:
    import pyarrow.csv as csv

    sink = pa.BufferOutputStream()
    csv.write_csv(table, sink, csv.WriteOptions(quoting_style="none"))
    write_bytes(path, sink.getvalue().to_pybytes())


def _instants(drive: SynthDrive, settings: Preset) -> Int64:
    """Mid-exposures (N,) of the reference camera, clear of the first and the last pose."""
    time_s = np.arange(_SETTLED_S, drive.truth.duration_s - _SETTLED_S, 1.0 / settings.picture_hz)
    return drive.condition.start_ns + np.round(time_s * 1e6).astype(np.int64) * 1000


def _write_pictures(folder: Path, drive: SynthDrive, settings: Preset, pool: ThreadPoolExecutor) -> Iterator[int]:
    """Write pictures, stamps, masks, calibrations and boxes; yields numbers of pictures done."""
    vehicle = drive.vehicle
    for name in CANONICAL_CAMERAS:
        (folder / "images" / name).mkdir(parents=True, exist_ok=True)
    for stage in ("factory", "online"):
        write_bytes(
            folder / "calibrations" / f"{stage}.json", json.dumps(vehicle.calibration(stage), indent=1).encode()
        )
    for name, mask in drive.own_masks.items():
        write_bytes(folder / "masks" / f"{name}.png", _encoded(".png", mask))
    instants = _instants(drive, settings)
    rows: list[dict[str, Any]] = []
    # Made before the threads start, or each would make them.
    drive.stage.prepare()
    lenses = drive.lenses
    frames = [(folder, drive, lenses, int(stamp), number) for number, stamp in enumerate(instants)]
    for boxes in pool.map(lambda frame: _write_frame(*frame), frames):
        rows += boxes
        yield len(CANONICAL_CAMERAS)
    if vehicle.kind.stagger_ns:
        half = vehicle.kind.exposure_ns // 2
        for place, name in enumerate(CANONICAL_CAMERAS):
            stamps = instants + place * vehicle.kind.stagger_ns
            kept = [stamp for number, stamp in enumerate(stamps) if (name, number) != drive.recipe.dropped]
            lines = [f"{stamp}.jpg,{stamp - half},{stamp + half}" for stamp in kept]
            text = "\n".join(["file,exposure_start_ns,exposure_end_ns", *lines, ""])
            write_bytes(folder / "images" / f"{name}.csv", text.encode())
    write_table(folder / "boxes.parquet", pa.Table.from_pylist(rows, schema=BOXES.schema), BOXES)


def _write_frame(
    folder: Path, drive: SynthDrive, lenses: Mapping[str, Lens], timestamp_ns: int, number: int
) -> list[dict[str, Any]]:
    """Write the seven pictures of one instant; returns the boxes of what they show."""
    vehicle, stage = drive.vehicle, drive.stage
    seen = np.zeros(len(stage.users), np.int64)
    instant = None
    for place, name in enumerate(CANONICAL_CAMERAS):
        stamp = timestamp_ns + place * vehicle.kind.stagger_ns
        if instant is None or vehicle.kind.stagger_ns:
            world_SE3_ego = drive.world_SE3_ego(np.array([stamp]))
            instant = stage.at((stamp - drive.condition.start_ns) * 1e-9, world_SE3_ego)
        if place == 0:
            reference, placements = world_SE3_ego, instant.placements
        if (name, number) == drive.recipe.dropped:
            continue
        seed = drive.seed + 1000 * number + 10 * place
        picture = stage.picture(instant, lenses[name], world_SE3_ego @ vehicle.ego_SE3_camera[name], seed)
        shown = picture.object[picture.object >= 0]
        seen = np.maximum(seen, np.bincount(shown, minlength=len(seen)))
        write_bytes(folder / "images" / name / f"{stamp}.jpg", _encoded(".jpg", picture.bgr))
    least = max(4.0, _BOX_SHARE * vehicle.width_px * vehicle.height_px)
    return _boxes(drive, timestamp_ns, reference, {key: at for key, at in placements.items() if seen[key] >= least})


def _boxes(
    drive: SynthDrive, timestamp_ns: int, world_SE3_ego: Poses, placements: dict[int, Any]
) -> list[dict[str, Any]]:
    if not placements:
        return []
    users = [drive.stage.users[key] for key in placements]
    yaw = np.array([place.yaw_rad for place in placements.values()])
    half = 0.5 * yaw
    zero = np.zeros_like(yaw)
    ground = [(place.x_m, place.y_m, 0.5 * user.body.size_m[2]) for user, place in zip(users, placements.values())]
    world_SE3_box = Poses(np.stack([np.cos(half), zero, zero, np.sin(half)], axis=1), np.array(ground))
    ego_SE3_world = world_SE3_ego.inverse()
    ego_SE3_box = ego_SE3_world @ world_SE3_box
    speed = np.array([place.speed_mps for place in placements.values()])
    velocity: Float64 = np.stack([speed * np.cos(yaw), speed * np.sin(yaw), zero], axis=1)
    velocity = velocity @ matrix_from_quaternion(ego_SE3_world.rotation)[0].T
    columns = ego_SE3_box.to_columns()
    return [
        {
            "timestamp_ns": timestamp_ns,
            "track_id": user.track_id,
            "category": user.body.category,
            **{name: float(column[row]) for name, column in columns.items()},
            **dict(zip(("length_m", "width_m", "height_m"), user.body.size_m)),
            **dict(zip(("vx_mps", "vy_mps", "vz_mps"), velocity[row].tolist())),
            "score": None,
            "source": SOURCE,
            "source_version": __version__,
        }
        for row, user in enumerate(users)
    ]


def _encoded(suffix: str, picture: AnyArray) -> bytes:
    import cv2

    return bytes(
        cv2.imencode(suffix, picture, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY] if suffix == ".jpg" else [])[1]
    )
