"""One training image as a method receives it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import torch
from torch import Tensor

from hybridworldsim.trainable.viewpoint import Viewpoint
from mirror.errors import DatasetError

_TENSORS: Final = ("rgb", "scored", "sky", "depth_m")


@dataclass(frozen=True, eq=False)
class TrainingImage:
    """An image that a step learns from.

    Attributes:
        viewpoint: camera of the image.
        rgb: (H, W, 3) float32 in [0, 1].
        scored: (H, W) bool: pixels of the static street, without road users, the vehicle itself and the lens border.
        sky: (H, W) bool, or None where the dataset has no such mask or the method does not read it.
        depth_m: (H, W) float32 camera z of multi-view stereo, 0 where unknown; None where the dataset has none.
        name: name of the image in messages.
        any_scored: whether a pixel is scored; None: not known yet. It is known of images on a GPU, which would have to
            be waited for.
    """

    viewpoint: Viewpoint
    rgb: Tensor
    scored: Tensor
    sky: Tensor | None
    depth_m: Tensor | None
    name: str = ""
    any_scored: bool | None = None

    def to(self, device: torch.device) -> TrainingImage:
        """Return the image on a device; the camera stays on the CPU, and the copy to a GPU is asynchronous."""
        if device.type == "cpu":
            return self
        tensors = {name: getattr(self, name) for name in _TENSORS}
        moved = {name: one.to(device, non_blocking=True) for name, one in tensors.items() if one is not None}
        return replace(self, **moved, any_scored=self.teaches)

    def pinned(self) -> TrainingImage:
        """Return the image in pinned memory, from which a GPU copies while others compute."""
        tensors = {name: getattr(self, name) for name in _TENSORS}
        return replace(self, **{name: one.pin_memory() for name, one in tensors.items() if one is not None})

    @property
    def teaches(self) -> bool:
        """Return whether the image has a pixel to learn from."""
        return bool(self.scored.any()) if self.any_scored is None else self.any_scored

    def require_finite(self) -> None:
        """Require that all numbers are finite; colours as integers are.

        Raises:
            DatasetError: a number is not.
        """
        tensors: dict[str, Tensor | None] = {
            "colours": self.rgb if self.rgb.is_floating_point() else None,
            "depths": self.depth_m,
            "pose": self.viewpoint.viewmat,
            "intrinsics": self.viewpoint.K,
        }
        for what, tensor in tensors.items():
            # A sum is finite only if all terms are; it is the cheapest test.
            if tensor is not None and not bool(tensor.sum().isfinite()):
                raise DatasetError(
                    f"{what} that are not finite", place=self.name or str(self.viewpoint.source),
                    expected="finite numbers", remedy="leave the image out, or correct its pose and depth",
                )  # fmt: skip

    @property
    def bytes(self) -> int:
        """Bytes in memory."""
        tensors = [getattr(self, name) for name in _TENSORS]
        return sum(tensor.nbytes for tensor in tensors if tensor is not None)
