"""What py123d reads of a KITTI-360 folder: ``python read.py FOLDER RESULT.json``, in an environment of its own."""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
from py123d.datatypes import BoxDetectionsSE3, EgoStateSE3, PinholeCameraMetadata
from py123d.parser.base_dataset_parser import ParsedCamera
from py123d.parser.kitti360.kitti360_parser import Kitti360Parser

root, out = (Path(word) for word in sys.argv[1:])
(drive,) = (child.name for child in (root / "data_poses").iterdir())


def rounded(values, digits=9):
    return [rounded(value, digits) for value in values] if hasattr(values, "__len__") else round(float(values), digits)


def pose(value):
    """Seven numbers: the quaternion, scalar first, and the translation."""
    return rounded([value.qw, value.qx, value.qy, value.qz, value.x, value.y, value.z], 12)


# Directions in a camera's frame.
POINTS = np.array([(x, y, 1.0) for x in (-0.4, 0.0, 0.3) for y in (-0.2, 0.1)])

cameras, frames = {}, []
with tempfile.TemporaryDirectory() as cache:
    parser = Kitti360Parser(["kitti360_train"], root, cache, 80.0, [drive], [], [])
    (log,) = parser.get_log_parsers()
    for moment in log.iter_modalities_sync():
        (ego,) = (one for one in moment.modalities if isinstance(one, EgoStateSE3))
        (boxes,) = (one for one in moment.modalities if isinstance(one, BoxDetectionsSE3))
        images = {}
        for camera in (one for one in moment.modalities if isinstance(one, ParsedCamera)):
            lens = camera.metadata
            images[lens.camera_name] = {
                "file": str(camera.relative_path),
                "timestamp_us": camera.timestamp.time_us,
                "world_SE3_camera": pose(camera.camera_to_global_se3),
            }
            cameras[lens.camera_name] = {
                "size_px": [lens.width, lens.height],
                "ego_SE3_camera": pose(lens.camera_to_imu_se3),
                "pixels_px": rounded(lens.project_to_image(POINTS)[0])
                if isinstance(lens, PinholeCameraMetadata)
                else None,
            }
        frames.append(
            {
                "timestamp_us": moment.timestamp.time_us,
                "world_SE3_ego": pose(ego.imu_se3),
                "images": images,
                "boxes": {
                    box.attributes.track_token: {
                        "label": box.attributes.label.name,
                        "world_SE3_box": pose(box.bounding_box_se3.center_se3),
                        "size_m": rounded(box.bounding_box_se3.array[7:]),
                    }
                    for box in boxes.box_detections
                },
            }
        )
out.write_text(json.dumps({"points": POINTS.tolist(), "cameras": cameras, "frames": frames}, indent=0) + "\n")
