"""What nerfstudio reads of a dataset through our dataparser: ``python read_dataset.py DATASET RESULT.json``.

The environment has nerfstudio and this toolkit.
"""

import json
import sys
from pathlib import Path

import torch

from mirror.export.nerfstudio_dataparser import MIRROR, MirrorDataParserConfig

root, out = Path(sys.argv[1]), sys.argv[2]
assert isinstance(MIRROR.config, MirrorDataParserConfig)
cameras = ("front_wide", "front_narrow", "front_left", "rear")
splits = {}
for split in ("train", "val"):
    config = MirrorDataParserConfig(data=root, camera=cameras, split="novel")
    found = config.setup().get_dataparser_outputs(split)
    rays = {}
    for row, path in enumerate(found.image_filenames):
        assert path.is_file()
        coords = torch.tensor([[y, x] for y in (40.0, 64.0) for x in (60.0, 96.0)])
        bundle = found.cameras.generate_rays(camera_indices=row, coords=coords)
        rays[str(path.relative_to(root))] = {
            "pixels": coords[:, [1, 0]].tolist(),
            "origin": bundle.origins[0].tolist(),
            "directions": bundle.directions.tolist(),
        }
    splits[split] = {"rays": rays, "points": len(found.metadata["points3D_xyz"])}
Path(out).write_text(json.dumps(splits, indent=0) + "\n")
