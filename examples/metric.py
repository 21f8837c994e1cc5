"""A metric in one file: the mean difference of horizontal edges between the renders of a submission and the images.

python examples/metric.py DATASET SUBMISSION
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

import mirror
from mirror.protocols import GroundTruth, decode_render, plan_views


def edge_error(render: Any, truth: Any, scored: Any) -> float:
    """Return the mean absolute difference of horizontal luma gradients over the scored pixels, in grey levels.

    Args:
        render: (H, W, 3) uint8.
        truth: (H, W, 3) uint8.
        scored: (H, W) whether a pixel is scored.
    """
    gradients = [np.diff(image.astype(np.float64) @ [0.299, 0.587, 0.114], axis=1) for image in (render, truth)]
    return float(np.abs(gradients[0] - gradients[1])[scored[:, 1:]].mean())


def main(folder: str, submission: str) -> None:
    """Print the mean of each camera."""
    manifest = json.loads((Path(submission) / "manifest.json").read_text())
    dataset, protocol = mirror.open(folder), mirror.load_protocol(manifest["protocol"])
    plan = plan_views(dataset, protocol, manifest["split"])
    truth = GroundTruth(dataset, protocol, plan.layers)
    errors: dict[str, list[float]] = {}
    for view in plan.views:
        data = (Path(submission) / view.path).read_bytes()
        render = decode_render(data, view.width_px, view.height_px, view.path)
        errors.setdefault(view.camera, []).append(edge_error(render, truth.image(view), truth.scored_mask(view)))
    for camera, values in sorted(errors.items()):
        print(f"{camera}: {np.mean(values):.3f}")


if __name__ == "__main__":
    main(*sys.argv[1:])
