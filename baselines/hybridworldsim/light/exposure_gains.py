"""The gains of training images, estimated from each image and its rendering."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import torch
from torch import Tensor

_DARK: Final = 0.03
_BRIGHT: Final = 0.95
_LEAST_PIXELS: Final = 64
_MOST: Final = math.log(1e4)
_SHARE: Final = 0.5
"""Share of the way to a new estimate that the gain of an image moves."""


def estimate_log_gain(image: Tensor, rendered: Tensor, light: Tensor, exposed: Tensor, scored: Tensor) -> float | None:
    """Return the logarithm of the gain by which an image differs from its rendering at gain one.

    Args:
        image: (H, W, 3) recorded colours; all arrays may hold some of the pixels only.
        rendered: (H, W, 3) rendered colours at gain one.
        light: (H, W, 3) light of the recorded colours, by the inverse of the camera's curve.
        exposed: (H, W, 3) light of the rendering at the sensor, at gain one.
        scored: (H, W) pixels of the static street.

    Returns:
        The median over pixels that are neither dark nor saturated; None where there are too few of them.
    """
    usable = scored & (image.amin(2) > _DARK) & (image.amax(2) < _BRIGHT)
    usable &= (rendered.amin(2) > _DARK) & (rendered.amax(2) < _BRIGHT)
    ratios = light[usable].sum(1).log() - exposed[usable].sum(1).log()
    return float(ratios.median()) if len(ratios) >= _LEAST_PIXELS else None


class ExposureGains:
    """The logarithms of the gains of training images; their mean over the images of a group is zero.

    A group is a traversal and a camera: the mean brightness of its images belongs to their appearance.
    """

    def __init__(self) -> None:
        self._values: dict[str, float] = {}
        self._groups: dict[str, str] = {}

    def __len__(self) -> int:
        return len(self._values)

    def log_gain(self, name: str, group: str) -> float:
        """Return the logarithm of an image's gain; 0 of an image without an estimate."""
        return self._values[name] - self._mean(group) if name in self._values else 0.0

    def update(self, name: str, group: str, estimate: float) -> None:
        """Move the gain of an image towards an estimate; an estimate that no camera has (above 10,000) is ignored.

        Args:
            name: name of the image.
            group: its group.
            estimate: logarithm of the gain by which the image differs from its rendering at gain one.
        """
        if not abs(estimate) < _MOST:
            return
        before = self._values.get(name, estimate)
        value = before + _SHARE * (estimate - before)
        self._values[name], self._groups[name] = value, group

    def state(self) -> dict[str, Tensor]:
        """Return the gains as tensors, for a checkpoint: names and groups as bytes, values as float64."""
        text = "\n".join(f"{name}\t{group}" for name, group in self._groups.items()).encode()
        return {
            "names": torch.tensor(list(text), dtype=torch.uint8),
            "values": torch.tensor(list(self._values.values()), dtype=torch.float64),
        }

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `state` returned."""
        self._values, self._groups = {}, {}
        for line, value in zip(bytes(state["names"].tolist()).decode().splitlines(), state["values"].tolist()):
            name, _, group = line.partition("\t")
            self._values[name], self._groups[name] = value, group

    def _mean(self, group: str) -> float:
        own = [value for name, value in self._values.items() if self._groups[name] == group]
        return sum(own) / len(own) if own else 0.0
