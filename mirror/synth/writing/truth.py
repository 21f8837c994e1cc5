"""Writes the ground truth of a recording beside it (docs/truth.md)."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

import numpy as np
import pyarrow as pa

from mirror.arrays import AnyArray, Int64
from mirror.errors import UsageError
from mirror.geometry import Poses
from mirror.schema.files import write_bytes, write_table
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.truth.files import FOLDER, TruthObject, write_document
from mirror.synth.truth.flow import rolling_flow, static_flow
from mirror.synth.truth.images import KINDS, Kind, truth_file
from mirror.synth.truth.tables import BOXES, POSES
from mirror.synth.writing.boxes import world_SE3_boxes
from mirror.synth.writing.schedule import ImageSchedule

if TYPE_CHECKING:
    from mirror.synth.render.scene import Instant, RenderedImage, RollingImage

TruthKind = Literal["depth", "normals", "semantic", "instance", "flow", "boxes", "poses"]
TRUTH_KINDS: Final[tuple[TruthKind, ...]] = get_args(TruthKind)
RENDERED: Final[frozenset[TruthKind]] = frozenset(TRUTH_KINDS) - {"poses"}
"""Kinds of truth that need rendered images."""


def parse_truth_kinds(text: str) -> tuple[TruthKind, ...]:
    """Parse a list of kinds of truth, separated by commas.

    Raises:
        UsageError: a name is not a kind of truth.
    """
    named = [name.strip() for name in text.split(",") if name.strip()]
    unknown = sorted(set(named) - set(TRUTH_KINDS))
    if unknown:
        raise UsageError(f"no truth of kind {unknown[0]!r}", expected=f"some of {','.join(TRUTH_KINDS)}")
    return tuple(kind for kind in TRUTH_KINDS if kind in named)


@dataclass(frozen=True)
class TruthRequest:
    """The image for which truth is written.

    Attributes:
        camera: camera of the image.
        true_ns: true mid-exposure time.
        recorded_ns: recorded mid-exposure time.
        next_ns: true mid-exposure time of the camera's next image; None for the last image.
    """

    camera: str
    true_ns: int
    recorded_ns: int
    next_ns: int | None


def write_image_truth(
    recording: Path,
    drive: SynthDrive,
    kinds: Sequence[TruthKind],
    request: TruthRequest,
    instant: Instant,
    image: RenderedImage | RollingImage,
) -> list[dict[str, Any]]:
    """Write the truth of one image.

    Args:
        recording: folder of the recording.
        drive: drive of the recording.
        kinds: kinds of truth to be written.
        request: the image.
        instant: the world at the time of the image.
        image: the rendered image.

    Returns:
        Rows of the true boxes table.
    """
    view, camera = image.view, drive.vehicle.cameras[request.camera]
    pose = drive.world_SE3_camera(request.camera, np.array([request.true_ns]))
    maps: dict[Kind, AnyArray] = {}
    if "depth" in kinds:
        maps["depth"] = view.distance_m
    if "normals" in kinds:
        normals = view.camera_normal.copy()
        normals[np.isinf(view.distance_m)] = np.nan
        maps["normals"] = normals
    if "semantic" in kinds:
        maps["semantic"] = view.label
    if "instance" in kinds:
        maps["instance"] = view.object + 1
    if "flow" in kinds and request.next_ns is not None:
        shutter = drive.vehicle.shutter(request.camera)
        if shutter.is_rolling:
            poses_at = partial(drive.poses_about, request.camera)
            maps["flow"] = rolling_flow(
                view.distance_m, camera, shutter, partial(poses_at, request.true_ns), partial(poses_at, request.next_ns)
            )
        else:
            later = drive.world_SE3_camera(request.camera, np.array([request.next_ns]))
            maps["flow"] = static_flow(view.distance_m, camera, pose, camera, later)
    for kind, values in maps.items():
        file = truth_file(recording / FOLDER, kind, request.camera, request.recorded_ns)
        write_bytes(file, KINDS[kind].encode(values))
    return _box_rows(drive, request, instant, image, pose) if "boxes" in kinds else []


def _box_rows(
    drive: SynthDrive,
    request: TruthRequest,
    instant: Instant,
    image: RenderedImage | RollingImage,
    world_SE3_camera: Poses,
) -> list[dict[str, Any]]:
    from mirror.synth.truth.boxes import PosedObject, measure_visibility

    numbers, places = list(instant.placements), list(instant.placements.values())
    road_users = [drive.road_users[number] for number in numbers]
    boxes = world_SE3_boxes(road_users, places)
    posed_objects = {
        number: PosedObject(
            user.body.model_at(place).transform(place.rotation, place.translation, number), boxes[row], user.body.size_m
        )
        for row, (number, user, place) in enumerate(zip(numbers, road_users, places))
    }
    camera = drive.vehicle.cameras[request.camera]
    visibility = measure_visibility(image.view.object, camera, world_SE3_camera, posed_objects)
    columns = boxes.to_columns()
    rows = []
    for index, number in enumerate(visibility.number.tolist()):
        row = numbers.index(number)
        bounds: Sequence[float | None] = (
            visibility.bounds_px[index].tolist() if visibility.pixels[index] else (None,) * 4
        )
        rows.append(
            {
                "camera": request.camera,
                "timestamp_ns": request.recorded_ns,
                "track_id": road_users[row].track_id,
                "category": road_users[row].body.category,
                **{name: float(column[row]) for name, column in columns.items()},
                **dict(zip(("length_m", "width_m", "height_m"), road_users[row].body.size_m)),
                "speed_mps": places[row].speed_mps,
                "visibility": float(visibility.visibility[index]),
                "pixels": int(visibility.pixels[index]),
                **dict(zip(("u_min_px", "v_min_px", "u_max_px", "v_max_px"), bounds)),
            }
        )
    return rows


def write_truth(
    recording: Path,
    drive: SynthDrive,
    kinds: Sequence[TruthKind],
    pose_ns: Int64,
    schedule: ImageSchedule | None,
    boxes: Sequence[Mapping[str, Any]],
) -> None:
    """Write the truth of a whole recording: poses, calibrations, boxes and, last, ``truth.json``.

    Args:
        recording: folder of the recording.
        drive: drive of the recording.
        kinds: kinds of truth to be written.
        pose_ns: (N,) timestamps of the recorded poses.
        schedule: when its images were taken; None: it has no images.
        boxes: rows from `write_image_truth`.
    """
    folder = recording / FOLDER
    bodies = {"ego": (drive.world_SE3_ego(pose_ns), pose_ns, pose_ns)}
    if schedule is not None:
        for name, kept in schedule.kept.items():
            true = schedule.true_ns[name][kept]
            bodies[name] = drive.world_SE3_camera(name, true), schedule.recorded_ns[name][kept], true
        write_bytes(folder / "calibrations.json", json.dumps(drive.vehicle.true_calibration(), indent=1).encode())
    parts = [
        pa.table({"body": [name] * len(true), "timestamp_ns": recorded, "true_ns": true, **poses.to_columns()})
        for name, (poses, recorded, true) in sorted(bodies.items())
    ]
    write_table(folder / "poses.parquet", pa.concat_tables(parts), POSES)
    if "boxes" in kinds:
        rows = sorted(boxes, key=lambda row: tuple(row[key] for key in BOXES.sorted_by))
        write_table(folder / "boxes.parquet", pa.Table.from_pylist(rows, schema=BOXES.schema), BOXES)
    objects = tuple(TruthObject(track_id=user.track_id, category=user.body.category) for user in drive.road_users)
    images: tuple[Kind, ...] = tuple(kind for kind in KINDS if kind in kinds)
    write_document(recording, drive.roi, images, objects)
