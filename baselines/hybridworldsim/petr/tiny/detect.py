"""Boxes of one frame from the trained network."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from hybridworldsim.petr.boxes import DecodedBoxes, decode_boxes
from hybridworldsim.petr.detector import is_finite
from hybridworldsim.petr.head import HeadOutput
from hybridworldsim.petr.tiny.network import TinyPetr
from hybridworldsim.petr.tiny.samples import CameraInput, rig_input
from mirror.annotation.detections import AnnotationError

_MOST = 100
_APART = 0.4
"""Of two boxes of one class whose middles are nearer than this share of the length, the one with less score is left
out: overlapping cameras see an object twice."""


def find_boxes(network: TinyPetr, cameras: CameraInput, *, min_score: float = 0.0) -> DecodedBoxes:
    """Find the boxes of a frame, in its ego frame, by falling score.

    Args:
        network: the trained network, in evaluation mode.
        cameras: images and rays of any number of cameras.
        min_score: boxes with a lower score are left out.

    Raises:
        AnnotationError: the network's outputs are not finite.
    """
    with torch.inference_mode():
        output, _ = network(rig_input([cameras], network.box_range.device))
    if not is_finite(output):
        raise AnnotationError("the network's outputs are not finite", expected="finite images and weights")
    return without_doubles(read_boxes(output, min_score))


def read_boxes(output: HeadOutput, min_score: float) -> DecodedBoxes:
    """Return the boxes of the first frame: at most one for each query, of its class with the best score."""
    best = output.logits.amax(-1, keepdim=True)
    alone = torch.where(output.logits >= best, output.logits, output.logits.new_tensor(-50.0))
    boxes = decode_boxes(replace(output, logits=alone), "length-width", most=_MOST, min_score=max(min_score, 1e-6))
    return boxes[0]


def without_doubles(boxes: DecodedBoxes) -> DecodedBoxes:
    """Remove boxes that overlap a box of their class with a higher score."""
    away = torch.cdist(boxes.centre_m[:, :2].double(), boxes.centre_m[:, :2].double())
    near = (away < _APART * boxes.size_m[:, :1]) & (boxes.label[:, None] == boxes.label)
    kept: list[int] = []
    for row in range(len(boxes.score)):
        if not bool(near[kept, row].any()):
            kept.append(row)
    return _rows(boxes, torch.tensor(kept, dtype=torch.long, device=boxes.score.device))


def _rows(boxes: DecodedBoxes, rows: Tensor) -> DecodedBoxes:
    return DecodedBoxes(**{name: value[rows] for name, value in vars(boxes).items()})
