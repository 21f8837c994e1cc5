"""What nuscenes-devkit reads of an export: ``python read.py EXPORT RESULT.json``, in an environment of its own."""

import json
import sys
from pathlib import Path

from nuscenes.nuscenes import NuScenes
from nuscenes.utils.geometry_utils import BoxVisibility, view_points

root, out = sys.argv[1:]
devkit = NuScenes("v1.0-mirror", root, verbose=False)
images = {}
for sample in devkit.sample:
    for channel, token in sample["data"].items():
        path, boxes, matrix = devkit.get_sample_data(token, box_vis_level=BoxVisibility.NONE)
        found = {}
        for box in boxes:
            track = devkit.get("sample_annotation", box.token)["instance_token"]
            corners = box.corners()
            found[track] = {
                "category": box.name,
                "corners_px": view_points(corners, matrix, normalize=True)[:2].T.tolist(),
                "depth_m": corners[2].tolist(),
                "speed_mps": [float(value) for value in devkit.box_velocity(box.token)],
            }
        images[str(Path(path).relative_to(root))] = {"channel": channel, "boxes": found}
scenes = [
    {"name": scene["name"], "samples": scene["nbr_samples"], "log": devkit.get("log", scene["log_token"])["logfile"]}
    for scene in devkit.scene
]
Path(out).write_text(json.dumps({"scenes": scenes, "images": images}, indent=0) + "\n")
