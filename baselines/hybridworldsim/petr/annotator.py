"""The annotator ``petr``: a published checkpoint, given as a file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Final, get_args

import numpy as np
import torch

from hybridworldsim.petr.boxes import DecodedBoxes, Generation, decode_boxes
from hybridworldsim.petr.checkpoint import Checkpoint, load_strictly, read_checkpoint
from hybridworldsim.petr.detector import CLASSES, Petr, is_finite
from hybridworldsim.petr.encoding import matrix_points
from hybridworldsim.petr.head import HeadSettings
from hybridworldsim.petr.rig import EGO_SE3_LIDAR, ORDER, InputRaster, choose_cameras, prepare
from mirror.annotation.detections import AnnotationError, Detections
from mirror.annotation.protocol import Annotator, require_settings, share_setting
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.devices import resolve_device
from mirror.errors import UsageError
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import rotate

_SETTINGS: Final = {
    "weights": "a published checkpoint (.pth); it must be given",
    "sha256": "its hash; a file with another one is refused",
    "generation": "width-length or length-width, for a checkpoint that does not state its version",
    "min_score": "boxes with a lower score are left out, 0.2 by default",
    "cameras": "the rig's names of the six cameras: front_wide:NAME,front_right:NAME,...",
    "raster": "width and height of the network's images, 800x320 by default; multiples of 32",
}


class PetrAnnotator:
    """An annotator that runs a network on one frame after the other.

    Args:
        checkpoint: the weights.
        device: torch device.
        min_score: least score of a box.
        cameras: the rig's names of the cameras, by position.
        raster: raster of the network's images.
    """

    def __init__(
        self, checkpoint: Checkpoint, device: str, min_score: float, cameras: Mapping[str, str], raster: InputRaster
    ) -> None:
        self.name, self.version = "petr", checkpoint.sha256[:8]
        settings = [
            checkpoint.sha256,
            checkpoint.generation,
            min_score,
            dict(cameras),
            raster.width_px,
            raster.height_px,
        ]
        self.fingerprint = f"petr {json.dumps(settings)}"
        self._checkpoint, self._device, self._min_score = checkpoint, torch.device(device), min_score
        self._cameras, self._raster = cameras, raster
        self._network = Petr(checkpoint.backbone, HeadSettings(multiview=checkpoint.multiview))
        load_strictly(self._network, checkpoint)
        self._network.to(self._device).eval()

    def annotate(self, frame: Frame) -> Detections:
        """Find the boxes of one frame."""
        images = choose_cameras(frame, self._cameras)
        rig = prepare(frame, images, self._raster, self._checkpoint.backbone)
        height, width = rig.images.shape[2] // Petr.stride, rig.images.shape[3] // Petr.stride
        points = matrix_points(
            torch.from_numpy(rig.image_from_lidar), height, width, rig.images.shape[2:], self._network.depths
        )
        with torch.inference_mode():
            output = self._network(
                torch.from_numpy(rig.images)[None].to(self._device), points[None].float().to(self._device)
            )
        if not is_finite(output):
            raise AnnotationError(
                "the network's outputs are not finite",
                place=f"frame {frame.frame_index}",
                remedy="name other weights with --set weights=FILE",
            )
        boxes = decode_boxes(output, self._checkpoint.generation, min_score=self._min_score)[0]
        return to_detections(boxes, frame.timestamp_ns)

    def close(self) -> None:
        """Do nothing: only memory is held."""


def to_detections(boxes: DecodedBoxes, timestamp_ns: int) -> Detections:
    """Return the boxes in the frame of the lidar as detections in the ego frame."""
    if not len(boxes.score):
        return Detections.empty(timestamp_ns)
    half = 0.5 * boxes.yaw_rad.double().cpu().numpy()
    zero = np.zeros(len(half))
    rotation = np.stack((np.cos(half), zero, zero, np.sin(half)), axis=1)
    pose = EGO_SE3_LIDAR @ Poses(rotation, boxes.centre_m.double().cpu().numpy())
    velocity = np.zeros((len(half), 3))
    velocity[:, :2] = boxes.velocity_mps.double().cpu().numpy()
    return Detections(
        timestamp_ns,
        pose,
        boxes.size_m.double().cpu().numpy(),
        rotate(EGO_SE3_LIDAR.rotation, velocity),
        tuple(CLASSES[label] for label in boxes.label.tolist()),
        boxes.score.double().cpu().numpy(),
    )


class _Installed:
    settings: Mapping[str, str] = _SETTINGS

    def open(self, dataset: Dataset, settings: Mapping[str, str], device: str) -> Annotator:
        """Read the checkpoint, and check device and settings."""
        require_settings("petr", settings, self.settings)
        if "weights" not in settings:
            raise UsageError(
                "no weights", place="--set", expected="weights=FILE, a published checkpoint of PETR (.pth)"
            )
        generation: Generation | None = None
        if "generation" in settings:
            known = {name: name for name in get_args(Generation)}
            if settings["generation"] not in known:
                raise UsageError(settings["generation"], place="--set generation", expected=" or ".join(known))
            generation = known[settings["generation"]]
        device = resolve_device(device).name
        checkpoint = read_checkpoint(Path(settings["weights"]), sha256=settings.get("sha256"), generation=generation)
        return PetrAnnotator(
            checkpoint,
            device,
            share_setting(settings, "min_score", 0.2),
            _cameras(settings.get("cameras", "")),
            _raster(settings.get("raster", "800x320")),
        )


def _cameras(text: str) -> dict[str, str]:
    names = {}
    for pair in filter(None, text.split(",")):
        position, _, name = pair.partition(":")
        if position not in ORDER or not name:
            raise UsageError(pair, place="--set cameras", expected=f"POSITION:NAME, of {', '.join(ORDER)}")
        names[position] = name
    return names


def _raster(text: str) -> InputRaster:
    parts = text.split("x")
    sizes = [int(part) for part in parts if part.isdecimal()]
    if len(sizes) != 2 or len(parts) != 2 or any(size < 32 or size % 32 for size in sizes):
        raise UsageError(text, place="--set raster", expected="WIDTHxHEIGHT, multiples of 32")
    return InputRaster(*sizes)


ANNOTATOR: Final = _Installed()
