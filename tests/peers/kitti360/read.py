"""What kitti360scripts reads of a folder: ``python read.py FOLDER RESULT.json``, in an environment of its own."""

import functools
import json
import sys
from pathlib import Path

import numpy as np
import yaml

# PyYAML 6 asks for the loader that older versions took by default.
yaml.load = functools.partial(yaml.load, Loader=yaml.SafeLoader)

from kitti360scripts.helpers.annotation import Annotation3D  # noqa: E402
from kitti360scripts.helpers.project import CameraFisheye, CameraPerspective  # noqa: E402

root, out = sys.argv[1:]
(drive,) = (child.name for child in (Path(root) / "data_poses").iterdir())


def rounded(values, digits=9):
    return [rounded(value, digits) for value in values] if hasattr(values, "__len__") else round(float(values), digits)


annotation = Annotation3D(str(Path(root) / "data_3d_bboxes"), drive)
objects = [obj for by_frame in annotation.objects.values() for obj in by_frame.values()]
boxes, cameras = {}, {}
for number in range(4):
    camera = (CameraPerspective if number < 2 else CameraFisheye)(root, drive, number)
    images = {}
    for frame in map(int, camera.frames):
        there = [obj for obj in objects if obj.timestamp in (-1, frame)]
        boxes[frame] = {
            obj.instanceId: {
                "name": obj.name,
                "at_rest": obj.timestamp == -1,
                "vertices_m": rounded(obj.vertices, 7),
            }
            for obj in there
        }
        pixels = {}
        for obj in there:
            (u, v), _ = camera.project_vertices(obj.vertices, frame)
            pixels[obj.instanceId] = rounded(np.stack([u, v], axis=1), 7)
        images[frame] = {"world_SE3_camera": rounded(camera.cam2world[frame], 12), "vertices_px": pixels}
    cameras[f"image_{number:02d}"] = {
        "size_px": [camera.width, camera.height],
        "projection": rounded(camera.K) if number < 2 else None,
        "images": images,
    }
Path(out).write_text(json.dumps({"boxes": boxes, "cameras": cameras}, indent=0) + "\n")
