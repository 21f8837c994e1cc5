"""nuScenes: the thirteen JSON tables of the nuScenes schema, with one scene for each traversal.

A sample is a frame of the rig. If boxes are rarer than frames, samples are the frames nearest to the boxes, as nuScenes
has keyframes, and other images are sweeps. Times are in microseconds; lenses are 3x3 matrices with the centre of the
first pixel at (0, 0), as OpenCV has it. The ego frame is MIRROR's. The global frame is the scene's world frame.

Source: https://github.com/nutonomy/nuscenes-devkit/blob/master/docs/schema_nuscenes.md
"""

from __future__ import annotations

import hashlib
import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from mirror.dataset.frames import Frame
from mirror.dataset.times import longitude_of, solar_date
from mirror.dataset.traversal import FrameBoxes
from mirror.export.files import encode_image
from mirror.export.layout import ExportLayout, Kept, Written
from mirror.export.lenses import pinhole_lens
from mirror.export.lidars import Sweep, list_sweeps, present_sweeps
from mirror.export.nuscenes_lidars import add_sweeps, sweep_files, to_us
from mirror.export.scene import ExportImage, ExportScene
from mirror.progress import ProgressReporter
from mirror.schema.files import write_bytes

VERSION: Final = "v1.0-mirror"
"""Folder of the tables, and the version to open."""

CHANNELS: Final = {
    "front_wide": "CAM_FRONT",
    "front_narrow": "CAM_FRONT_NARROW",
    "front_left": "CAM_FRONT_LEFT",
    "front_right": "CAM_FRONT_RIGHT",
    "rear_left": "CAM_BACK_LEFT",
    "rear_right": "CAM_BACK_RIGHT",
    "rear": "CAM_BACK",
}
"""Channels by canonical camera; other cameras keep their names in capital letters."""

CATEGORIES: Final = {
    "car": "vehicle.car",
    "truck": "vehicle.truck",
    "bus": "vehicle.bus.rigid",
    "trailer": "vehicle.trailer",
    "construction_vehicle": "vehicle.construction",
    "pedestrian": "human.pedestrian.adult",
    "motorcycle": "vehicle.motorcycle",
    "bicycle": "vehicle.bicycle",
    "traffic_cone": "movable_object.trafficcone",
    "barrier": "movable_object.barrier",
}
"""Names of nuScenes by MIRROR's category; other categories keep their names."""

_UNKNOWN_POINTS: Final = -1
"""The devkit's evaluation ignores boxes with 0 points; the number of lidar points is unknown here."""

_RARE: Final = 1.5
_NAMES: Final = (
    "category", "attribute", "visibility", "instance", "sensor", "calibrated_sensor", "ego_pose", "log", "scene",
    "sample", "sample_data", "sample_annotation", "map",
)  # fmt: skip
_VISIBILITY: Final = ("0-40", "40-60", "60-80", "80-100")

Row = dict[str, Any]


def channel_name(camera: str) -> str:
    """Return the name of a camera's channel."""
    return CHANNELS.get(camera, camera if camera.startswith("CAM_") else f"CAM_{camera.upper()}")


class _Tables:
    """The tables that are being filled; rows of the same token are written once."""

    def __init__(self) -> None:
        self._rows: dict[str, dict[str, Row]] = {name: {} for name in _NAMES}

    def add(self, table: str, *key: object, **values: Any) -> str:
        """Add a row, or find the row of the same key; returns its token."""
        token = hashlib.sha256("\0".join([table, *map(str, key)]).encode()).hexdigest()[:32]
        self._rows[table].setdefault(token, {"token": token, **values})
        return token

    def add_named(self, table: str, token: str, **values: Any) -> None:
        """Add a row whose token the schema fixes."""
        self._rows[table][token] = {"token": token, **values}

    def row(self, table: str, token: str) -> Row:
        """A row by its token."""
        return self._rows[table][token]

    def link(self, table: str, tokens: Sequence[str]) -> None:
        """Chain rows by ``prev`` and ``next``."""
        for before, token, after in zip(["", *tokens[:-1]], tokens, [*tokens[1:], ""]):
            self._rows[table][token].update(prev=before, next=after)

    def count(self, table: str) -> int:
        """The number of rows of a table."""
        return len(self._rows[table])

    def write(self, folder: Path) -> tuple[Path, ...]:
        """Write all tables; returns their paths."""
        paths = []
        for name, rows in self._rows.items():
            write_bytes(folder / f"{name}.json", json.dumps(list(rows.values()), indent=0).encode())
            paths.append(folder / f"{name}.json")
        return tuple(paths)


def _write(scene: ExportScene, out: Path, _: ProgressReporter) -> Written:
    tables = _Tables()
    for number, level in enumerate(_VISIBILITY, 1):
        tables.add_named("visibility", str(number), level=f"v{level}", description=f"visible: {level} %")
    logs = []
    sweeps = present_sweeps(list_sweeps(scene))[0]
    for traversal_id, frames in scene.by_traversal():
        logs.append(_add_traversal(tables, scene, traversal_id, frames, sweeps.get(traversal_id, ())))
    blank = f"maps/{scene.scene['scene_id']}.png"
    write_bytes(out / blank, encode_image(np.zeros((10, 10), np.uint8), ".png"))
    tables.add("map", blank, log_tokens=sorted(set(logs)), category="semantic_prior", filename=blank)
    return Written((*tables.write(out / VERSION), out / blank), boxes=tables.count("sample_annotation"))


def _add_traversal(
    tables: _Tables,
    scene: ExportScene,
    traversal_id: str,
    frames: Sequence[tuple[Frame, list[ExportImage]]],
    sweeps: Sequence[Sweep],
) -> str:
    traversal = scene.traversals[traversal_id]
    log = tables.add(
        "log", traversal["drive_id"], logfile=traversal["drive_id"], vehicle=traversal["vehicle_id"],
        # nuScenes states the date of the place.
        date_captured=solar_date(traversal["entry_ns"], longitude_of(traversal)),
        location=scene.scene["scene_id"],
    )  # fmt: skip
    token = tables.add(
        "scene", traversal_id, log_token=log, name=traversal_id,
        description=f"{traversal['light']}, {traversal['weather']}",
    )  # fmt: skip
    annotated = _boxes_of_samples([frame for frame, _ in frames])
    samples = [
        tables.add("sample", traversal_id, frame.frame_index, timestamp=to_us(frame.timestamp_ns), scene_token=token)
        for frame, _ in frames
        if frame.frame_index in annotated
    ]
    tables.link("sample", samples)
    tables.row("scene", token).update(
        nbr_samples=len(samples), first_sample_token=samples[0], last_sample_token=samples[-1]
    )
    times = np.array([tables.row("sample", sample)["timestamp"] for sample in samples])
    data: dict[str, list[str]] = defaultdict(list)
    key_frames = iter(samples)
    for frame, images in frames:
        is_key = frame.frame_index in annotated
        sample = next(key_frames) if is_key else samples[int(np.argmin(np.abs(times - to_us(frame.timestamp_ns))))]
        for item in images:
            data[item.image.camera].append(_add_image(tables, item, sample, is_key=is_key))
    stamps = dict(zip(samples, times.tolist()))
    data |= add_sweeps(tables.add, traversal_id, traversal["drive_id"], frames[0][0], sweeps, stamps)
    for tokens in data.values():
        tables.link("sample_data", tokens)
    _add_boxes(tables, traversal_id, samples, [annotated[key] for key in sorted(annotated)])
    return log


def _boxes_of_samples(frames: Sequence[Frame]) -> Mapping[int, FrameBoxes | None]:
    """The frames that become samples, with their boxes in the world frame: each instant of boxes once."""
    nearest: dict[int, tuple[int, int, FrameBoxes]] = {}
    for frame in frames:
        boxes = frame.boxes("world")
        if len(boxes):
            distance = abs(boxes.timestamp_ns - frame.timestamp_ns)
            known = nearest.get(boxes.timestamp_ns)
            if known is None or distance < known[0]:
                nearest[boxes.timestamp_ns] = (distance, frame.frame_index, boxes)
    found: dict[int, FrameBoxes | None] = {index: boxes for _, index, boxes in nearest.values()}
    period = _median_step([frame.timestamp_ns for frame in frames])
    if len(nearest) > 1 and _median_step(sorted(nearest)) > _RARE * period:
        return found
    return {frame.frame_index: found.get(frame.frame_index) for frame in frames}


def _median_step(stamps: Sequence[int]) -> float:
    return float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0


def _add_image(tables: _Tables, item: ExportImage, sample: str, *, is_key: bool) -> str:
    image, camera = item.image, item.lens
    channel = channel_name(image.camera)
    mounting = image.calibration.ego_SE3_camera
    ego = item.world_SE3_camera @ mounting.inverse()
    sensor = tables.add("sensor", channel, channel=channel, modality="camera")
    translation, rotation = mounting.translation[0].tolist(), mounting.rotation[0].tolist()
    matrix = camera.intrinsic_matrix(first_pixel_centre=0.0).tolist()
    # Two columns that the devkit ignores, for cameras that have a rolling shutter.
    shutter = image.shutter
    columns = {"shutter_direction": shutter.direction, "readout_ns": shutter.readout_ns} if shutter.is_rolling else {}
    calibrated = tables.add(
        "calibrated_sensor", item.drive_id, channel, translation, rotation, matrix, *columns.values(),
        sensor_token=sensor, translation=translation, rotation=rotation, camera_intrinsic=matrix, **columns,
    )  # fmt: skip
    key = (item.frame.traversal_id, image.camera, image.timestamp_ns)
    time = to_us(image.timestamp_ns)
    pose = tables.add(
        "ego_pose", *key, timestamp=time, rotation=ego.rotation[0].tolist(), translation=ego.translation[0].tolist()
    )
    return tables.add(
        "sample_data", *key, sample_token=sample, ego_pose_token=pose, calibrated_sensor_token=calibrated,
        timestamp=time, fileformat=item.suffix[1:], is_key_frame=is_key, height=camera.height_px,
        width=camera.width_px, filename=_image_path(item),
    )  # fmt: skip


def _add_boxes(tables: _Tables, traversal_id: str, samples: Sequence[str], boxes: Sequence[FrameBoxes | None]) -> None:
    instances: dict[str, list[str]] = defaultdict(list)
    categories: dict[str, str] = {}
    for sample, found in zip(samples, boxes):
        if found is None:
            continue
        for row, (track, word) in enumerate(zip(found.track_id, found.category)):
            name = CATEGORIES.get(word, word)
            category = tables.add("category", word, name=name, description=f"MIRROR: {word}")
            categories.setdefault(track, category)
            instance = tables.add("instance", traversal_id, track, category_token=categories[track])
            attributes = [tables.add("attribute", name, name=name, description="") for name in found.attributes[row]]
            length, width, height = found.size_m[row].tolist()
            annotation = tables.add(
                "sample_annotation", sample, track, sample_token=sample, instance_token=instance,
                attribute_tokens=attributes, visibility_token="", size=[width, length, height],
                translation=found.pose.translation[row].tolist(), rotation=found.pose.rotation[row].tolist(),
                num_lidar_pts=_UNKNOWN_POINTS, num_radar_pts=0,
            )  # fmt: skip
            instances[instance].append(annotation)
    for instance, tokens in instances.items():
        tables.link("sample_annotation", tokens)
        tables.row("instance", instance).update(
            nbr_annotations=len(tokens),
            first_annotation_token=tokens[0],
            last_annotation_token=tokens[-1],
        )


def _image_path(item: ExportImage) -> str:
    """Every image lies in ``samples``: whether it is of a keyframe stands in the table."""
    drive, stamp = item.frame.traversal_id, to_us(item.image.timestamp_ns)
    channel = channel_name(item.image.camera)
    return f"samples/{channel}/{drive}__{channel}__{stamp}{item.suffix}"


LAYOUT: Final = ExportLayout(
    name="nuscenes",
    title="nuScenes v1.0 tables",
    lens_of=pinhole_lens,
    image_path=_image_path,
    mask_path=None,
    needs_all_masks=False,
    write=_write,
    sweeps=sweep_files,
    kept=(
        Kept("pose of the vehicle at each image", "ego_pose", "1e-9 m, 1e-12 rad"),
        Kept("mounting of the cameras", "calibrated_sensor", "exact"),
        Kept("focal lengths, principal point", "camera_intrinsic", "1e-12 px"),
        Kept("rolling shutter", "calibrated_sensor: shutter_direction, readout_ns", "exact, of the recorded rows"),
        Kept("time of images, frames and lidar sweeps", "sample, sample_data", "0.5 us"),
        Kept("files of lidar sweeps", "sample_data; the name ends in the format", "exact"),
        Kept("mounting of the lidars", "calibrated_sensor", "exact"),
        Kept("pose of boxes", "sample_annotation", "1e-9 m, 1e-12 rad"),
        Kept("size of boxes", "sample_annotation", "exact"),
        Kept("tracks", "instance", "exact up to names"),
        Kept("category of boxes", "category", "exact up to names"),
        Kept("attributes of boxes", "attribute", "exact"),
        Kept("traversals", "scene", "exact"),
        Kept("drive, vehicle", "log", "exact"),
        Kept("light and weather", "description of a scene", "exact"),
    ),
    lost=(
        "velocity of boxes: the devkit derives it from positions",
        "scores and sources of boxes",
        "the instant of boxes between frames: it becomes that of the nearest frame",
        "masks, depth maps, points",
        "distortion: images are undistorted",
        "exposure and time offsets",
        "the geodetic reference of the world frame",
        "calibration stages, validity and covariance",
        "poses between images",
    ),
)
