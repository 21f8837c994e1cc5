"""What LeRobot reads of an export: ``python read.py EXPORT RESULT.json``, in an environment of its own."""

import json
import sys
from pathlib import Path

from lerobot.datasets.lerobot_dataset import LeRobotDataset

root, out = Path(sys.argv[1]), sys.argv[2]
dataset = LeRobotDataset("mirror/street", root=root)
rows = []
for number in range(len(dataset)):
    row = dataset[number]
    plain = {name: value for name, value in row.items() if name == "task"}
    for name, value in row.items():
        if name in dataset.meta.image_keys:
            plain[name] = {"shape": list(value.shape), "mean": float(value.mean())}
        elif name != "task":
            plain[name] = value.tolist()
    rows.append(plain)
result = {
    "fps": dataset.fps,
    "episodes": dataset.num_episodes,
    "cameras": sorted(dataset.meta.camera_keys),
    "episode_of": [episode["traversal_id"] for episode in dataset.meta.episodes],
    "image_mean": {name: dataset.meta.stats[name]["mean"].ravel().tolist() for name in dataset.meta.image_keys},
    "rows": rows,
}
Path(out).write_text(json.dumps(result, indent=0) + "\n")
