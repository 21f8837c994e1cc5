"""What webdataset reads of an export: ``python read.py EXPORT RESULT.json``, in an environment of its own."""

import hashlib
import json
import sys
from pathlib import Path

import webdataset

root, out = Path(sys.argv[1]), sys.argv[2]
shards = {}
for path in sorted(root.glob("*.tar")):
    samples = []
    for raw, decoded in zip(
        webdataset.WebDataset(str(path), shardshuffle=False),
        webdataset.WebDataset(str(path), shardshuffle=False).decode("rgb8"),
    ):
        images = {
            name: {
                "sha256": hashlib.sha256(raw[name]).hexdigest(),
                "shape": list(value.shape),
                "mean": float(value.mean()),
            }
            for name, value in decoded.items()
            if name.endswith((".jpg", ".png"))
        }
        samples.append({"key": decoded["__key__"], "images": images, "json": decoded["json"]})
    shards[path.name] = samples
Path(out).write_text(json.dumps(shards, indent=0) + "\n")
