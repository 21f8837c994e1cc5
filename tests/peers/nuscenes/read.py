"""What nuscenes-devkit reads of a folder: ``python read.py FOLDER RESULT.json``, in an environment of its own."""

import json
import sys
from pathlib import Path

from nuscenes.nuscenes import NuScenes
from nuscenes.utils.geometry_utils import BoxVisibility, view_points

root, out = sys.argv[1:]
devkit = NuScenes("v1.0-mini", root, verbose=False)


def rounded(values, digits=9):
    return [rounded(value, digits) for value in values] if hasattr(values, "__len__") else round(float(values), digits)


images = {}
for sample in devkit.sample[::7]:
    for channel, token in sample["data"].items():
        data = devkit.get("sample_data", token)
        if not channel.startswith("CAM"):
            continue
        path, boxes, matrix = devkit.get_sample_data(token, box_vis_level=BoxVisibility.NONE)
        pose = devkit.get("ego_pose", data["ego_pose_token"])
        images[str(Path(path).relative_to(root))] = {
            "channel": channel,
            "timestamp_us": data["timestamp"],
            "sample_us": sample["timestamp"],
            "translation": rounded(pose["translation"]),
            "rotation": rounded(pose["rotation"], 12),
            "boxes": {
                devkit.get("sample_annotation", box.token)["instance_token"]: {
                    "category": box.name,
                    "corners_px": rounded(view_points(box.corners(), matrix, normalize=True)[:2].T.tolist(), 7),
                    "depth_m": rounded(box.corners()[2].tolist()),
                    "velocity_mps": rounded(devkit.box_velocity(box.token).tolist()),
                }
                for box in boxes
            },
        }
Path(out).write_text(json.dumps({"images": images}, indent=0) + "\n")
