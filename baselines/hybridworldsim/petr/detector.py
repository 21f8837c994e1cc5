"""The whole network: backbone, neck and head, with the published names of the parameters."""

from __future__ import annotations

from typing import Final, Literal

import torch
from torch import Tensor, nn

from hybridworldsim.petr.encoding import lid_depths
from hybridworldsim.petr.head import DetectionHead, HeadOutput, HeadSettings
from hybridworldsim.petr.neck import Neck
from hybridworldsim.petr.resnet import ResNet50
from hybridworldsim.petr.vovnet import VoVNet99

Backbone = Literal["vovnet99", "resnet50"]
CLASSES: Final = (
    "car", "truck", "construction_vehicle", "bus", "trailer", "barrier", "motorcycle", "bicycle", "pedestrian",
    "traffic_cone",
)  # fmt: skip
"""Classes of the published checkpoints, in their order."""

_NECK: Final = 256


class Petr(nn.Module):
    """PETR with a published backbone.

    Args:
        backbone: ``vovnet99`` or ``resnet50``.
        settings: sizes and ranges of the head.
    """

    stride = 16

    def __init__(self, backbone: Backbone = "vovnet99", settings: HeadSettings | None = None) -> None:
        super().__init__()
        self.img_backbone = VoVNet99() if backbone == "vovnet99" else ResNet50()
        self.img_neck = Neck(self.img_backbone.channels, _NECK)
        self.pts_bbox_head = DetectionHead(settings or HeadSettings(), _NECK)

    @property
    def depths(self) -> Tensor:
        """Depths (D,) of the points of a ray."""
        settings = self.pts_bbox_head.settings
        return lid_depths(settings.depths, settings.depth_start_m, settings.position_range_m[3])

    def forward(self, images: Tensor, points: Tensor) -> HeadOutput:
        """Find boxes.

        Args:
            images: (B, N, 3, H, W) normalised images of N cameras.
            points: (B, N, H / 16, W / 16, D, 3) points of rays in the frame of the boxes.
        """
        features = self.img_neck(self.img_backbone(images.flatten(0, 1)))
        out: HeadOutput = self.pts_bbox_head(features.unflatten(0, images.shape[:2]), points)
        return out


class LastLayer(nn.Module):
    """The outputs of the last decoder layer as tensors, in the form of ONNX files."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor, points: Tensor) -> tuple[Tensor, Tensor]:
        """Return the logits (B, Q, classes) and codes (B, Q, 10)."""
        out = self.network(images, points)
        return out.logits[-1], out.codes[-1]


def is_finite(output: HeadOutput) -> bool:
    """Return whether all outputs of the last layer are finite."""
    return bool(torch.isfinite(output.logits[-1]).all() and torch.isfinite(output.codes[-1]).all())
