"""What gsplat's ``Parser`` reads of an export: ``python read.py EXPORT RESULT.json``, with ``examples`` importable."""

import json
import sys
from pathlib import Path

import numpy as np
from datasets.colmap import Parser

root, out = sys.argv[1:]
parser = Parser(root)
images = {
    name: {
        "path": str(Path(path).relative_to(root)),
        "camera_to_world": np.asarray(pose).tolist(),
        "matrix": np.asarray(parser.Ks_dict[camera]).tolist(),
        "size": [int(side) for side in parser.imsize_dict[camera]],
    }
    for name, path, pose, camera in zip(parser.image_names, parser.image_paths, parser.camtoworlds, parser.camera_ids)
}
points = {"xyz": parser.points.tolist(), "rgb": parser.points_rgb.tolist()}
Path(out).write_text(json.dumps({"images": images, "points": points}, indent=0) + "\n")
