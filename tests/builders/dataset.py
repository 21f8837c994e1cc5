"""Recorded folders without ingest: straight drives through regions of interest, with exact truth.

The benchmarks use it too, to make a large dataset of rows without images.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from mirror.dataset.images.depth_codec import encode_depth
from mirror.dataset.index.build import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout, manifest_sha256, seal
from mirror.geometry.cameras import Camera
from mirror.geometry.geodesy import TangentFrame
from mirror.schema.documents import (
    CleaningOptions,
    CleaningReport,
    DatasetDocument,
    DriveDocument,
    ImageTotals,
    RecordingSource,
    Rig,
    RigCamera,
    Roi,
    TriggerOptions,
)
from mirror.schema.files import encode_table, write_bytes, write_json
from mirror.schema.tables import CALIBRATIONS, DEPTH, EGO_POSES, IMAGES, PASSES, POINTS, Table

SECOND = 1_000_000_000
EPOCH = 1_700_000_000 * SECOND
SEVEN = ("front_wide", "front_narrow", "front_left", "front_right", "rear_left", "rear_right", "rear")


@dataclass(frozen=True)
class Pass:
    """One accepted pass: a straight line through the scene's centre at constant speed.

    Attributes:
        scene_id: the scene.
        entry_ns: first instant; poses begin 1 s before.
        frames: frames of every camera.
        frame_ns: period of the cameras.
        heading_deg: direction of travel, clockwise from north.
        speed_mps: speed.
        offset_m: how far left of the centre the line runs.
        pose_ns: period of the poses.
        light: day, dusk or night.
        weather: clear, rain ...
        dropped: (camera, frame) without an image.
        images: encoded bytes of an image, by camera, written for every frame; None: only rows are written.
        codec: how they are encoded.
    """

    scene_id: str
    entry_ns: int = EPOCH
    frames: int = 5
    frame_ns: int = 100_000_000
    heading_deg: float = 30.0
    speed_mps: float = 10.0
    offset_m: float = 0.0
    pose_ns: int = 100_000_000
    light: str = "day"
    weather: str = "clear"
    dropped: frozenset[tuple[str, int]] = frozenset()
    images: Mapping[str, bytes] | None = None
    codec: str = "jpeg"

    @property
    def exit_ns(self) -> int:
        return self.entry_ns + self.frames * self.frame_ns

    def position(self, timestamp_ns: np.ndarray) -> np.ndarray:
        """World positions (N, 3): the exact truth of every pose."""
        middle = (self.entry_ns + self.exit_ns) // 2
        along = (np.asarray(timestamp_ns) - middle) / SECOND * self.speed_mps
        heading = np.radians(self.heading_deg)
        forward, left = np.array([np.sin(heading), np.cos(heading)]), np.array([-np.cos(heading), np.sin(heading)])
        flat = along[:, None] * forward + self.offset_m * left
        return np.column_stack([flat, np.zeros(len(flat))])


@dataclass
class Builder:
    """Writes a dataset as ingest would leave it, without an index."""

    root: Path
    cameras: Sequence[str] = ("front_wide", "front_left", "front_right")
    size: tuple[int, int] = (48, 32)
    lenses: Mapping[str, Camera] = field(default_factory=dict)
    rig_id: str = "rig"
    scenes: dict[str, Roi] = field(default_factory=dict)
    shutter: Mapping[str, object] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.layout = Layout(self.root)
        write_json(self.layout.document, DatasetDocument(trigger=TriggerOptions(), cleaning=CleaningOptions()))
        self.write_rois()
        if self.cameras:
            self.write_rig()

    def write_rig(self, static_masks: Mapping[str, str] | None = None) -> None:
        """The rig of the drives to come; static masks: file beside it, by camera."""
        masks = static_masks or {}
        rig = Rig(
            rig_id=self.rig_id,
            vehicle_type="van",
            reference_camera=self.cameras[0],
            cameras=tuple(RigCamera(name=name, source_name=name, static_mask=masks.get(name)) for name in self.cameras),
        )
        write_json(self.layout.rig(self.rig_id), rig)

    def scene(self, scene_id: str, longitude_deg: float = -79.4, latitude_deg: float = 43.6, **more: object) -> Roi:
        place = {} if "frame" in more else {"longitude_deg": longitude_deg, "latitude_deg": latitude_deg}
        self.scenes[scene_id] = Roi.model_validate({"scene_id": scene_id, **place, **more})
        self.write_rois()
        return self.scenes[scene_id]

    def write_rois(self) -> None:
        features = [
            {"type": "Feature", "geometry": None, "properties": roi.model_dump(mode="json")}
            for roi in self.scenes.values()
        ]
        write_json(self.layout.rois, {"type": "FeatureCollection", "features": features})

    def drive(self, drive_id: str, passes: Sequence[Pass], *, vehicle_id: str = "v1", refused: int = 0) -> list[str]:
        """Write a drive and its traversals; the ids of the traversals come back."""
        ids = [f"{item.scene_id}.{drive_id}.{item.entry_ns // 1_000_000}" for item in passes]
        hashes = {}
        for traversal_id, item in zip(ids, passes):
            self._recorded(traversal_id, drive_id, vehicle_id, item)
            hashes[f"traversal:{traversal_id}"] = manifest_sha256(self.layout.recorded(traversal_id))
        rows = [self._ledger(drive_id, key, item) for key, item in zip(ids, passes)]
        rows += [self._ledger(drive_id, None, passes[0])] * refused
        ledger = encode_rows(rows, PASSES)
        document = DriveDocument(
            drive_id=drive_id,
            vehicle_id=vehicle_id,
            vehicle_type="van",
            rig_id=self.rig_id if self.cameras else None,
            source=RecordingSource(reader="test", name=drive_id, files=1, bytes=1, fingerprint="0" * 64),
            configuration="0" * 64,
            scenes=tuple(self.scenes),
            frame=self.scenes[passes[0].scene_id].frame,
            time_base="Unix nanoseconds",
            body_frame="ego",
            is_clip=False,
            city=None,
            start_ns=min(item.entry_ns for item in passes),
            end_ns=max(item.exit_ns for item in passes),
            cleaning=CleaningReport(
                poses=1, kept=1, invalid=0, backward_time=0, duplicate_time=0, repeated=0, outliers=0, restarts=0
            ),
        )
        folder = self.layout.drive(drive_id)
        write_bytes(folder / "passes.parquet", ledger)
        write_json(folder / "drive.json", document)
        files = {"passes.parquet": ledger, "drive.json": (folder / "drive.json").read_bytes()}
        seal(folder, files, derived_from=hashes)
        return ids

    def layer(
        self, traversal_id: str, kind: str, name: str, table: Table, rows: Sequence[Mapping[str, object]]
    ) -> Path:
        """Write one layer; ``name`` is source@version."""
        folder = self.layout.layer(traversal_id, kind, *name.split("@"))
        data = encode_rows(rows, table)
        write_bytes(folder / f"{table.name}.parquet", data)
        seal(folder, {f"{table.name}.parquet": data}, derived_from={})
        return folder

    def _recorded(self, traversal_id: str, drive_id: str, vehicle_id: str, item: Pass) -> None:
        folder = self.layout.recorded(traversal_id)
        images = self.image_table(traversal_id, item)
        tables = {
            "ego_poses.parquet": encode_table(self._poses(item), EGO_POSES),
            "images.parquet": encode_table(images, IMAGES),
            "calibrations.parquet": encode_rows(
                [
                    calibration(camera, number, self.size, vehicle_id, drive_id, **self._lens(camera))
                    for number, camera in enumerate(self.cameras)
                ],
                CALIBRATIONS,
            ),
        }
        for name, data in tables.items():
            write_bytes(folder / name, data)
        if item.images is not None:
            for uri, camera in zip(images.column("uri").to_pylist(), images.column("camera").to_pylist()):
                write_bytes(self.root / uri, item.images[camera])
        total = sum(images.column("byte_length").to_pylist())
        seal(folder, tables, derived_from={}, images=ImageTotals(count=images.num_rows, bytes=total))

    def _poses(self, item: Pass) -> pa.Table:
        stamps = np.arange(item.entry_ns - SECOND, item.exit_ns + SECOND + 1, item.pose_ns)
        world = item.position(stamps)
        roi = self.scenes[item.scene_id]
        yaw = np.pi / 2 - np.radians(item.heading_deg)
        n = len(stamps)
        quaternion = np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])
        quaternion *= 1.0 if quaternion[0] >= 0 else -1.0
        columns: dict[str, object] = {
            "timestamp_ns": stamps,
            **{name: np.full(n, quaternion[k]) for k, name in enumerate(("qw", "qx", "qy", "qz"))},
            **{name: world[:, k] for k, name in enumerate(("tx_m", "ty_m", "tz_m"))},
            "sigma_m": pa.nulls(n, pa.float64()),
            "orientation": ["recorded"] * n,
        }
        if roi.longitude_deg is None or roi.latitude_deg is None:
            columns.update({name: pa.nulls(n, pa.float64()) for name in ("longitude_deg", "latitude_deg", "height_m")})
        else:
            frame = TangentFrame(roi.longitude_deg, roi.latitude_deg, roi.height_m)
            columns.update(zip(("longitude_deg", "latitude_deg", "height_m"), frame.to_geodetic(world)))
        return pa.table(columns)

    def image_table(self, traversal_id: str, item: Pass) -> pa.Table:
        camera = np.repeat(np.array(self.cameras, dtype=object), item.frames)
        frame = np.tile(np.arange(item.frames), len(self.cameras))
        # Each camera fires 1 ms after the one before it.
        stamps = (
            item.entry_ns + frame * item.frame_ns + np.repeat(np.arange(len(self.cameras)), item.frames) * 1_000_000
        )
        keep = [pair not in item.dropped for pair in zip(camera, frame.tolist())]
        camera, frame, stamps = camera[keep], frame[keep], stamps[keep]
        n = len(camera)
        names = [f"{name}/{stamp}.jpg" for name, stamp in zip(camera, stamps.tolist())]
        encoded = item.images
        digest = {} if encoded is None else {key: hashlib.sha256(data).digest() for key, data in encoded.items()}
        return pa.table(
            {
                "camera": pa.array(camera, pa.string()),
                "timestamp_ns": stamps,
                "exposure_start_ns": stamps - 5_000_000,
                "exposure_end_ns": stamps + 5_000_000,
                "frame_index": pa.array(frame, pa.int32()),
                "width_px": pa.array([self._size(name)[0] for name in camera], pa.int32()),
                "height_px": pa.array([self._size(name)[1] for name in camera], pa.int32()),
                "uri": [f"traversals/{traversal_id}/recorded/{name}" for name in names],
                "byte_offset": pa.repeat(pa.scalar(0, pa.int64()), n),
                "byte_length": pa.array([1000 if encoded is None else len(encoded[key]) for key in camera], pa.int64()),
                "codec": [item.codec] * n,
                "video_pts": pa.nulls(n, pa.int64()),
                "sha256": pa.array(
                    [digest.get(key) or hashlib.sha256(name.encode()).digest() for key, name in zip(camera, names)],
                    pa.binary(32),
                ),
                "privacy": ["raw"] * n,
            }
        )

    def _size(self, camera: str) -> tuple[int, int]:
        lens = self.lenses.get(camera)
        return self.size if lens is None else (lens.width_px, lens.height_px)

    def _lens(self, camera: str) -> dict[str, Any]:
        return {**(asdict(self.lenses[camera]) if camera in self.lenses else {}), **self.shutter}

    def _ledger(self, drive_id: str, traversal_id: str | None, item: Pass) -> dict[str, object]:
        duration = (item.exit_ns - item.entry_ns) / SECOND
        refused = traversal_id is None
        return {
            "scene_id": item.scene_id,
            "drive_id": drive_id,
            "traversal_id": traversal_id,
            "decision": "refused" if refused else "accepted",
            "rule": "min_duration" if refused else None,
            "measured": duration if refused else None,
            "threshold": 10.0 if refused else None,
            "entry_ns": item.entry_ns,
            "exit_ns": item.exit_ns,
            "entry_kind": "crossing",
            "exit_kind": "crossing",
            "duration_s": duration,
            "path_m": duration * item.speed_mps,
            "inside_path_m": duration * item.speed_mps,
            "overlap": 1.0,
            "visits": 1,
            "split": False,
            "poses": item.frames,
            "closest_m": abs(item.offset_m),
            "mean_speed_mps": item.speed_mps,
            "heading_in_deg": item.heading_deg,
            "heading_out_deg": item.heading_deg,
            "light": item.light,
            "light_source": "metadata",
            "weather": item.weather,
            "weather_source": "metadata",
        }


def calibration(
    camera: str,
    number: int,
    size: tuple[int, int],
    vehicle_id: str = "v1",
    drive_id: str = "d",
    stage: str = "factory",
    **more: object,
) -> dict[str, object]:
    """A pinhole camera that looks along the ego's x, ``number`` decimetres left of it."""
    return {
        "vehicle_id": vehicle_id,
        "drive_id": drive_id,
        "camera": camera,
        "stage": stage,
        "valid_from_ns": None,
        "valid_to_ns": None,
        "model": "pinhole",
        "width_px": size[0],
        "height_px": size[1],
        "fx_px": 40.0,
        "fy_px": 40.0,
        "cx_px": size[0] / 2,
        "cy_px": size[1] / 2,
        "distortion": [],
        "qw": 0.5,
        "qx": -0.5,
        "qy": 0.5,
        "qz": -0.5,
        "tx_m": 1.5,
        "ty_m": 0.1 * number,
        "tz_m": 1.6,
        "time_offset_ns": 0,
        "shutter_direction": "global",
        "readout_ns": 0,
        "covariance": None,
        "method": None,
        **more,
    }


def write_two_drives(root: Path, image: bytes) -> Path:
    """Write a dataset of two drives of two cameras, with four and three frames, and its index.

    Args:
        root: its folder.
        image: encoded bytes of every image, 48x32.
    """
    cameras = ("front_wide", "rear")
    builder = Builder(root, cameras=cameras)
    builder.scene("a")
    builder.drive("d0", [Pass("a", frames=4, images=dict.fromkeys(cameras, image))])
    builder.drive("d1", [Pass("a", frames=3, heading_deg=200.0, images=dict.fromkeys(cameras, image))])
    build_index(root)
    return root


def box(timestamp_ns: int, track_id: str, **more: object) -> dict[str, object]:
    """A car 10 m ahead of the ego."""
    return {
        "timestamp_ns": timestamp_ns,
        "track_id": track_id,
        "category": "car",
        "qw": 1.0,
        "qx": 0.0,
        "qy": 0.0,
        "qz": 0.0,
        "tx_m": 10.0,
        "ty_m": 0.0,
        "tz_m": 0.8,
        "length_m": 4.0,
        "width_m": 2.0,
        "height_m": 1.6,
        "vx_mps": 0.0,
        "vy_mps": 0.0,
        "vz_mps": None,
        "score": 0.5,
        "source": "petr",
        "source_version": "1",
        **more,
    }


def mask_row(camera: str, timestamp_ns: int, uri: str, data: bytes = b"", **more: object) -> dict[str, object]:
    """A mask of one image."""
    return {
        "camera": camera,
        "timestamp_ns": timestamp_ns,
        "kind": "dynamic",
        "uri": uri,
        "byte_length": len(data),
        "sha256": hashlib.sha256(data).digest(),
        "source": "sam",
        "source_version": "1",
        **more,
    }


def encode_rows(rows: Sequence[Mapping[str, object]], table: Table) -> bytes:
    """A table's file from rows."""
    plain = pa.schema(
        [item.with_type(pa.string()) if pa.types.is_dictionary(item.type) else item for item in table.schema]
    )
    return encode_table(pa.Table.from_pylist([dict(row) for row in rows], schema=plain), table)


def write_reconstruction(
    builder: Builder, traversal_id: str, camera: str, timestamp_ns: int, *, depth_m: float = 7.0, version: str = "1"
) -> None:
    """A layer with one flat depth map, and one with two points."""
    depth = LayerWriter(builder.layout, traversal_id, "depth", "sweep", version)
    file = depth.file("map.png", encode_depth(np.full((4, 6), depth_m)))
    lens = {"width_px": 6, "height_px": 4, "fx_px": 5.0, "fy_px": 5.0, "cx_px": 3.0, "cy_px": 2.0}
    depth.finish(DEPTH, [{"camera": camera, "timestamp_ns": timestamp_ns, **lens, **file}], {"estimator": "sweep"})
    place = {"x_m": depth_m, "y_m": 2.0, "z_m": 3.0, "r": 10, "g": 20, "b": 30}
    points = [
        {"point": 0, **place, "kind": "ground", "views": 3, "sigma_m": 0.5},
        {"point": 1, **place, "kind": "background", "views": 4, "sigma_m": None},
    ]
    LayerWriter(builder.layout, traversal_id, "points", "sweep", version).finish(POINTS, points, {})
