"""What nuplan-devkit reads of a log: ``python read.py FOLDER RESULT.json``, in an environment of its own."""

import json
import sys
from pathlib import Path

from nuplan.database.nuplan_db_orm.frame import Frame
from nuplan.database.nuplan_db_orm.nuplandb import NuPlanDB
from nuplan.database.utils.geometry import view_points

root, out = (Path(word) for word in sys.argv[1:])
(log,) = (root / "splits" / "mini").iterdir()
devkit = NuPlanDB(str(root), str(log))


def rounded(values, digits=9):
    return [rounded(value, digits) for value in values] if hasattr(values, "__len__") else round(float(values), digits)


cameras = {
    camera.channel: {
        "size_px": [camera.width, camera.height],
        "intrinsic": rounded(camera.intrinsic_np),
        "distortion": rounded(camera.distortion_np, 12),
        "translation": rounded(camera.translation_np, 12),
        "rotation": rounded(camera.quaternion.elements, 12),
    }
    for camera in devkit.camera.all()
}
images = {}
for camera in devkit.camera.all():
    for image in sorted(camera.images, key=lambda one: one.timestamp)[::13]:
        boxes = {}
        for box in image.boxes(Frame.SENSOR):
            row = devkit.lidar_box[box.token]
            corners = box.corners()
            boxes[box.track_token] = {
                "category": row.category.name,
                "corners_px": rounded(view_points(corners, camera.intrinsic_np, normalize=True)[:2].T, 7),
                "depth_m": rounded(corners[2]),
                "velocity_mps": [row.vx, row.vy, row.vz],
                "confidence": row.confidence,
            }
        images[image.filename] = {
            "channel": camera.channel,
            "timestamp_us": image.timestamp,
            "lidar_us": image.lidar_pc.timestamp,
            "epsg": image.ego_pose.epsg,
            "translation": rounded(image.ego_pose.translation_np),
            "rotation": rounded(image.ego_pose.quaternion.elements, 12),
            "boxes": boxes,
        }
result = {"log": devkit.log_name, "vehicle": devkit.log.vehicle_name, "cameras": cameras, "images": images}
out.write_text(json.dumps(result, indent=0) + "\n")
