"""What waymo-open-dataset reads of a folder: ``python read.py FOLDER RESULT.json``, in an environment of its own."""

import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import tensorflow as tf
from waymo_open_dataset import v2
from waymo_open_dataset.v2.perception.box import BoxType
from waymo_open_dataset.v2.perception.camera_image import CameraName
from waymo_open_dataset.v2.perception.context import RollingShutterReadOutDirection
from waymo_open_dataset.wdl_limited.camera.ops import py_camera_model_ops

root, out = (Path(word) for word in sys.argv[1:])


def rounded(values, digits=9):
    return [rounded(value, digits) for value in values] if hasattr(values, "__len__") else round(float(values), digits)


def table(tag):
    (file,) = (root / tag).iterdir()
    return pd.read_parquet(file)


def components(kind, rows):
    return [kind.from_dict(row) for row in rows.to_dict("records")]


def matrix(transform):
    return np.reshape(transform.transform, (4, 4))


def corners(box):
    """Corners in the vehicle's frame: the heading turns +x to the front face."""
    signs = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    length, width, height = box.size.numpy
    cos, sin = np.cos(box.heading), np.sin(box.heading)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return signs * 0.5 * np.array([length, width, height]) @ turn.T + box.center.numpy


def project(calibration, image, points):
    """Pixels of points in the world, as of a global shutter at the stamp of the image's pose."""
    lens, velocity, shutter = calibration.intrinsic, image.velocity, image.rolling_shutter_params
    intrinsic = [lens.f_u, lens.f_v, lens.c_u, lens.c_v, lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]
    numbers = [*image.pose.transform]
    for part in (velocity.linear_velocity, velocity.angular_velocity):
        numbers += [part.x, part.y, part.z]
    numbers += [
        image.pose_timestamp,
        shutter.shutter,
        shutter.camera_trigger_time,
        shutter.camera_readout_done_time,
    ]
    return py_camera_model_ops.world_to_image(
        tf.constant(np.reshape(calibration.extrinsic.transform, (4, 4)), tf.float32),
        tf.constant(intrinsic, tf.float32),
        tf.constant(
            [calibration.width, calibration.height, RollingShutterReadOutDirection.GLOBAL_SHUTTER.value], tf.int32
        ),
        tf.constant(numbers, tf.float32),
        tf.constant(points, tf.float32),
    ).numpy()


COMPONENTS = {
    "vehicle_pose": v2.VehiclePoseComponent,
    "camera_calibration": v2.CameraCalibrationComponent,
    "camera_image": v2.CameraImageComponent,
    "lidar_box": v2.LiDARBoxComponent,
    "stats": v2.StatsComponent,
}
rows = {tag: components(kind, table(tag)) for tag, kind in COMPONENTS.items()}
poses = {one.key.frame_timestamp_micros: matrix(one.world_from_vehicle) for one in rows["vehicle_pose"]}
lenses = {one.key.camera_name: one for one in rows["camera_calibration"]}
box_stamps = sorted({one.key.frame_timestamp_micros for one in rows["lidar_box"]})
images = []
for number in lenses:
    for image in [one for one in rows["camera_image"] if one.key.camera_name == number][::13]:
        middle_us = image.pose_timestamp * 1e6
        box_us = min(box_stamps, key=lambda stamp: abs(stamp - middle_us))
        boxes = {}
        for label in rows["lidar_box"]:
            if label.key.frame_timestamp_micros == box_us:
                world = corners(label.box) @ poses[box_us][:3, :3].T + poses[box_us][:3, 3]
                *pixels, seen = project(lenses[number], image, world).T
                boxes[label.key.laser_object_id] = {
                    "type": BoxType(label.type).name,
                    "box": rounded(label.box.numpy(np.float64), 12),
                    "corners_px": rounded(np.transpose(pixels), 6),
                    "seen": [bool(value) for value in seen],
                }
        shutter = image.rolling_shutter_params
        images.append(
            {
                "camera": CameraName(number).name,
                "pose": rounded(matrix(image.pose), 12),
                "pose_s": image.pose_timestamp,
                "exposure_s": [shutter.camera_trigger_time, shutter.camera_readout_done_time],
                "box_us": box_us,
                "vehicle_pose": rounded(poses[box_us], 12),
                "boxes": boxes,
            }
        )
cameras = {
    CameraName(number).name: {
        "size_px": [one.width, one.height],
        "shutter": RollingShutterReadOutDirection(one.rolling_shutter_direction).name,
        "extrinsic": rounded(matrix(one.extrinsic), 12),
    }
    for number, one in lenses.items()
}
stats = rows["stats"][0]
result = {
    "columns": {tag: {field.name: str(field.type) for field in kind.schema()} for tag, kind in COMPONENTS.items()},
    "stats": [stats.time_of_day, stats.location, stats.weather],
    "cameras": cameras,
    "images": images,
}
out.write_text(json.dumps(result, indent=0) + "\n")
