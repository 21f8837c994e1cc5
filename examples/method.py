"""A method in one file: it renders every view of a camera in the mean colour of the camera's training images.

mirror reconstruct DATASET --split novel --method examples/method.py:METHOD --out model
mirror render DATASET model --split novel --method examples/method.py:METHOD --out submission
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mirror import Dataset
from mirror.methods import AppearancePolicy, ReconstructionResult, ReconstructionTask, RenderView


class MeanColour:
    """See `mirror.methods.InstalledMethod`."""

    def reconstruct(self, dataset: Dataset, task: ReconstructionTask, out: Path, progress: Any) -> ReconstructionResult:
        """Write the mean colour of each camera, without the images that the task withholds."""
        colours: dict[str, list[Any]] = {}
        for frame in dataset.where(split=task.split, role="train", scene=task.scene).frames():
            for name, image in frame.images.items():
                if (frame.traversal_id, name, image.timestamp_ns) not in task.withheld:
                    colours.setdefault(name, []).append(image.decode().mean(axis=(0, 1)))
        np.savez(out / "colours.npz", **{name: np.mean(values, axis=0) for name, values in colours.items()})
        return ReconstructionResult(out)

    def open(self, model: Path, appearance: AppearancePolicy) -> Callable[[RenderView], Any]:
        """Return the renderer: a function from a view to its pixels."""
        with np.load(model / "colours.npz") as file:
            colours = dict(file)

        def render(view: RenderView) -> Any:
            return np.full((view.height_px, view.width_px, 3), colours[view.camera]).astype(np.uint8)

        return render


METHOD = MeanColour()
