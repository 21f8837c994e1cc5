"""What nerfstudio reads of an export: ``python read.py EXPORT RESULT.json``, in an environment of its own."""

import json
import sys
from pathlib import Path

import torch
from nerfstudio.data.dataparsers.nerfstudio_dataparser import NerfstudioDataParserConfig

root, out = Path(sys.argv[1]), sys.argv[2]
config = NerfstudioDataParserConfig(
    data=root, orientation_method="none", center_method="none", auto_scale_poses=False, downscale_factor=1
)
splits = {}
for split in ("train", "val"):
    found = config.setup().get_dataparser_outputs(split)
    rays = {}
    for row, path in enumerate(found.image_filenames):
        height, width = int(found.cameras.height[row]), int(found.cameras.width[row])
        coords = torch.tensor([[y, x] for y in (0.5, 40.0, height / 2) for x in (0.5, 60.0, width / 2, width - 0.5)])
        bundle = found.cameras.generate_rays(camera_indices=row, coords=coords)
        rays[str(path.relative_to(root))] = {
            "pixels": coords[:, [1, 0]].tolist(),
            "origin": bundle.origins[0].tolist(),
            "directions": bundle.directions.tolist(),
        }
    masks = [str(path.relative_to(root)) for path in found.mask_filenames or []]
    splits[split] = {"rays": rays, "masks": masks}
Path(out).write_text(json.dumps(splits, indent=0) + "\n")
