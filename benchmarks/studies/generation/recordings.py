"""Recordings of the clips' rig, as `mirror ingest` reads them: images, poses, calibrations and boxes of road users."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa

from benchmarks.studies.generation.street_clips import VIEWS, StreetRecorder, StreetRig
from hybridworldsim.generation.clips.clip import ABSENT
from mirror.arrays import Float64
from mirror.geometry import Poses
from mirror.geometry.poses import to_pose_numbers
from mirror.schema.files import write_bytes, write_json
from mirror.synth.errors import Errors
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.writing.boxes import make_box_rows
from mirror.synth.writing.images import encode_image, write_boxes
from mirror.synth.writing.poses import pose_stamps, write_poses
from mirror.synth.writing.recordings import LICENCE

RIG_ID: Final = "street-rig"
ROI_RADIUS_M: Final = 300.0
"""The drives begin outside the preset's region of 200 m."""
_LEAST_PX: Final = 4
"""A road user has a box if some image shows it with so many pixels, as in other recordings of the synthetic street."""


def write_recording(folder: Path, drive: SynthDrive, rig: StreetRig, spacing_m: float, stretch_m: float) -> None:
    """Write the recording of a drive along the first stretch of its road; a finished recording is kept.

    Poses and calibrations have no errors. ``recording.json`` is written last.

    Args:
        folder: folder of the recording.
        drive: the drive; its effects are rendered as they are.
        rig: the cameras.
        spacing_m: metres of road between images.
        stretch_m: metres of road that have images.
    """
    if (folder / "recording.json").is_file():
        return
    write_poses(folder, replace(drive, recipe=replace(drive.recipe, poses="csv")), Errors.none())
    recorder, boxes = StreetRecorder(drive, rig), []
    for time_s in image_times_s(drive, spacing_m, stretch_m).tolist():
        stamp_ns = drive.condition.start_ns + round(time_s * 1e9)
        ego, shown = recorder.ego(np.array([time_s])), []
        for view, rendered in zip(VIEWS, recorder.with_traffic(time_s, ego)):
            write_bytes(folder / "images" / view / f"{stamp_ns}.jpg", encode_image(".jpg", rendered.bgr))
            numbers, counts = np.unique(rendered.view.object, return_counts=True)
            shown += numbers[(numbers != ABSENT) & (counts >= _LEAST_PX)].tolist()
        users = [drive.road_users[number] for number in sorted(set(shown))]
        boxes.append(make_box_rows(users, [user.motion.at(time_s) for user in users], ego, stamp_ns))
    write_boxes(folder, pa.concat_tables(boxes))
    write_bytes(folder / "calibrations" / "online.json", json.dumps(_calibrations(rig), indent=1).encode())
    write_json(folder / "recording.json", _document(drive))


def image_times_s(drive: SynthDrive, spacing_m: float, stretch_m: float) -> Float64:
    """Return the times of images: of the first pose at or beyond each multiple of a distance.

    A standing vehicle then has one image.
    """
    times_s = drive.seconds(pose_stamps(drive))
    steps_m = np.linalg.norm(np.diff(drive.truth.poses(times_s).translation, axis=0), axis=1)
    driven_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    rows = np.searchsorted(driven_m, np.arange(0.0, min(stretch_m, float(driven_m[-1])), spacing_m))
    return times_s[np.unique(rows)]


def write_region(path: Path, drive: SynthDrive, scene_id: str) -> None:
    """Write the region of interest of a road, with the frame of the drive's scene, for `mirror ingest --rois`."""
    roi = drive.roi.model_copy(update={"scene_id": scene_id, "radius_m": ROI_RADIUS_M})
    feature = {
        "type": "Feature",
        "geometry": {"type": "Point", "coordinates": [roi.longitude_deg, roi.latitude_deg]},
        "properties": roi.model_dump(mode="json", exclude_none=True),
    }
    write_json(path, {"type": "FeatureCollection", "features": [feature]})


def _calibrations(rig: StreetRig) -> list[dict[str, object]]:
    return [
        {
            "camera": view,
            **rig.camera.to_row(),
            "ego_SE3_camera": list(to_pose_numbers(Poses.from_matrix(matrix[None]))),
            "method": "synthetic, truth",
        }
        for view, matrix in zip(VIEWS, rig.ego_SE3_camera)
    ]


def _document(drive: SynthDrive) -> dict[str, object]:
    return {
        "format": "mirror-folder",
        "version": "1.0",
        "drive_id": drive.drive_id,
        "vehicle_id": RIG_ID,
        "vehicle_type": "street",
        "rig_id": RIG_ID,
        "time_base": "unix_ns",
        "frame": {"kind": "wgs84"},
        "body_frame": "ego",
        "city": drive.roi.city,
        "weather": drive.condition.weather,
        "licence": LICENCE,
        "reference_camera": VIEWS[1],
        "cameras": {view: {} for view in VIEWS},
    }
