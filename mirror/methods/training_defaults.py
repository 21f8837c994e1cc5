"""The defaults of a training that follow the device: the width of the images and the budget."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from mirror.devices import CPU


@dataclass(frozen=True)
class TrainingDefaults:
    """The width and the budget of a training for which none is given.

    Attributes:
        width_px: wider images are scaled down to this width.
        steps: number of steps of each block; None: not limited.
        core_minutes: processor time of each block; None: not limited.
    """

    width_px: int
    steps: int | None = None
    core_minutes: float | None = None

    def describe(self, *, width: bool, budget: bool) -> str:
        """Return the defaults as options; empty if none is used.

        Args:
            width: whether the default width is used.
            budget: whether the default budget is used.
        """
        length = f"--minutes {self.core_minutes:g}" if self.steps is None else f"--steps {self.steps}"
        return " ".join([f"--width {self.width_px}"] * width + [length] * budget)


ON_CPU: Final = TrainingDefaults(240, core_minutes=10.0)
ON_GPU: Final = TrainingDefaults(960, steps=30_000)
"""The width of the paper's renders, and the steps of 3DGS."""


def training_defaults(device: str) -> TrainingDefaults:
    """Return the defaults of a training on a device, named as in torch."""
    return ON_CPU if device == CPU else ON_GPU
