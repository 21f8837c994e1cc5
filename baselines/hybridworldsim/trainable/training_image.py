"""One training image as a method receives it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from hybridworldsim.trainable.viewpoint import Viewpoint


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
    """

    viewpoint: Viewpoint
    rgb: Tensor
    scored: Tensor
    sky: Tensor | None
    depth_m: Tensor | None
    name: str = ""

    def to(self, device: torch.device) -> TrainingImage:
        """Return the image on a device; the camera stays on the CPU, and the copy to a GPU is asynchronous."""
        if device.type == "cpu":
            return self
        names = ("rgb", "scored", "sky", "depth_m")
        tensors = {name: getattr(self, name) for name in names}
        return replace(
            self,
            **{name: one.to(device, non_blocking=True) for name, one in tensors.items() if one is not None},
        )

    @property
    def bytes(self) -> int:
        """Bytes in memory."""
        tensors = (self.rgb, self.scored, self.sky, self.depth_m)
        return sum(tensor.nbytes for tensor in tensors if tensor is not None)
