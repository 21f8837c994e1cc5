"""What av2 reads of a log: ``python read.py FOLDER RESULT.json``, in an environment of its own."""

import json
import sys
from pathlib import Path

from av2.datasets.sensor.av2_sensor_dataloader import AV2SensorDataLoader
from av2.geometry.utm import CityName, convert_city_coords_to_wgs84
from av2.utils.io import read_feather

root, out = (Path(word) for word in sys.argv[1:])
(log,) = (child.name for child in root.iterdir())
loader = AV2SensorDataLoader(data_dir=root, labels_dir=root)


def rounded(values, digits=9):
    return [rounded(value, digits) for value in values] if hasattr(values, "__len__") else round(float(values), digits)


table = read_feather(root / log / "annotations.feather")
annotations = {}
for label_ns in loader.get_ordered_log_lidar_timestamps(log):
    tracks = table.loc[table["timestamp_ns"] == label_ns, "track_uuid"]
    annotations[label_ns] = list(zip(tracks, loader.get_labels_at_lidar_timestamp(log, label_ns)))
images = {}
for folder in sorted((root / log / "sensors" / "cameras").iterdir()):
    camera = loader.get_log_pinhole_camera(log, folder.name)
    for file in sorted(folder.iterdir())[::13]:
        stamp = int(file.stem)
        pose = loader.get_city_SE3_ego(log, stamp)
        box_ns = min(annotations, key=lambda other: (abs(other - stamp), other))
        boxes = {}
        for track, cuboid in annotations[box_ns]:
            uv, points, _ = camera.project_ego_to_img_motion_compensated(
                cuboid.vertices_m, pose, loader.get_city_SE3_ego(log, box_ns)
            )
            boxes[track] = {
                "category": str(cuboid.category),
                "corners_px": rounded(uv[:, :2].tolist(), 7),
                "depth_m": rounded(points[:, 2].tolist()),
            }
        wgs84 = convert_city_coords_to_wgs84(pose.translation[None, :2], CityName.PIT)[0]
        images[f"{folder.name}/{file.name}"] = {
            "box_ns": box_ns,
            "translation": rounded(pose.translation.tolist()),
            "rotation": rounded(pose.rotation.tolist(), 12),
            "latitude_longitude": rounded(wgs84.tolist(), 12),
            "boxes": boxes,
        }
out.write_text(json.dumps({"images": images}, indent=0) + "\n")
