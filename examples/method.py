"""A method in one file: it renders every view of a camera in the mean colour of the camera's training images.

mirror reconstruct DATASET --split novel --method examples/method.py:METHOD --out model
mirror render DATASET model --split novel --method examples/method.py:METHOD --out submission
mirror simulate DATASET model --scenario free-traffic --policy idm --method examples/method.py:METHOD --out rollout
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mirror import Dataset
from mirror.methods import AppearancePolicy, Capabilities, ReconstructionResult, ReconstructionTask, RenderView


@dataclass(frozen=True)
class Rendering:
    """Colours (0 to 1), cover (0 to 1) and depth (camera z); see `mirror.methods.depth_renderers.DepthRendering`."""

    rgb: Any
    alpha: Any
    depth_m: Any


@dataclass(frozen=True)
class MeanColourRenderer:
    """Renders views; with `render` also for `mirror simulate`, which needs the depth to place road users."""

    colours: Mapping[str, Any]

    def __call__(self, view: RenderView) -> Any:
        """Return the pixels (H, W, 3) of a view."""
        return np.full((view.height_px, view.width_px, 3), self.colours[view.camera]).astype(np.uint8)

    def render(self, view: RenderView) -> Rendering:
        """Return the image of a view as a wall 1 km away."""
        size = (view.height_px, view.width_px)
        return Rendering(self(view) / np.float32(255.0), np.ones(size, np.float32), np.full(size, 1e3, np.float32))


class MeanColour:
    """See `mirror.methods.Method`."""

    capabilities = Capabilities(renders_depth=True)

    def reconstruct(self, dataset: Dataset, task: ReconstructionTask, out: Path, progress: Any) -> ReconstructionResult:
        """Write the mean colour of each camera, without the images that the task withholds."""
        colours: dict[str, list[Any]] = {}
        for frame in dataset.where(split=task.split, role="train", scene=task.scene).frames():
            for name, image in frame.images.items():
                if (frame.traversal_id, name, image.timestamp_ns) not in task.withheld:
                    colours.setdefault(name, []).append(image.decode().mean(axis=(0, 1)))
        np.savez(out / "colours.npz", **{name: np.mean(values, axis=0) for name, values in colours.items()})
        return ReconstructionResult(out)

    def open(self, model: Path, appearance: AppearancePolicy) -> MeanColourRenderer:
        """Return the renderer: a function from a view to its pixels."""
        with np.load(model / "colours.npz") as file:
            return MeanColourRenderer(dict(file))


METHOD = MeanColour()
