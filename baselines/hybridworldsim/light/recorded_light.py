"""All light of a block's recordings beside the street's own colours: cameras, exposure, noise, headlights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from pydantic import BaseModel
from torch import Tensor, nn

from hybridworldsim.light.exposure_controller import (
    EVERY_PX,
    ExposureController,
    controller_from,
    light_features,
)
from hybridworldsim.light.headlights import HeadlightField
from hybridworldsim.light.sensor_noise import SensorNoise
from hybridworldsim.light.trained_response import TrainedResponse
from hybridworldsim.trainable.viewpoint import Source, Viewpoint
from mirror.arrays import Float64

DAY: Final = "day"
DARK: Final = ("dusk", "night")
"""Lights in which a vehicle drives with headlights."""


@dataclass(frozen=True, eq=False)
class RecordedCamera:
    """A camera in a traversal, as light sees it.

    Attributes:
        source: traversal and camera.
        light: light of the traversal.
        ego_SE3_camera: (4, 4) mounting of the camera on the vehicle.
    """

    source: Source
    light: str
    ego_SE3_camera: Float64


class LightDocument(BaseModel):
    """The document of a model's light: everything that is not a tensor.

    Attributes:
        cameras: source, light, and (4, 4) mounting of each camera, by rows.
        headlights: whether there is a field of headlights.
        controllers: numbers of the law of exposure by group, see `ExposureController.numbers`.
        noise: standard deviations by group, see `SensorNoise`.
        width_px: width of the images in which noise was measured.
    """

    cameras: list[tuple[str, str, str, list[float]]]
    headlights: bool
    controllers: dict[str, list[float]]
    noise: dict[str, list[float]]
    width_px: int


def group_of(source: Source) -> str:
    """Return the group of a camera in a traversal, whose images share an appearance."""
    return f"{source.traversal_id}/{source.camera}"


class RecordedLight(nn.Module):
    """The camera's response, the law of its exposure, its noise, and the headlights of the vehicle.

    Args:
        cameras: the cameras of the training images.
        headlights: whether vehicles that were recorded in the dark carry light; it needs traversals by day as well,
            which show what the light falls on.
        seed: seed of the first numbers.
    """

    def __init__(self, cameras: Sequence[RecordedCamera], *, headlights: bool, seed: int = 0) -> None:
        super().__init__()
        self.recorded = {camera.source: camera for camera in cameras}
        self.response = TrainedResponse(sorted({camera.source.camera for camera in cameras}))
        lights = {camera.light for camera in cameras}
        has_both = DAY in lights and not lights.isdisjoint(DARK)
        self.headlights = HeadlightField(seed) if headlights and has_both else None
        self.controllers: dict[str, ExposureController] = {}
        self.noise: dict[str, SensorNoise] = {}
        self.width_px = 0

    def carries_light(self, source: Source) -> bool:
        """Return whether the vehicle drove with headlights when a source was recorded."""
        return self.headlights is not None and source in self.recorded and self.recorded[source].light in DARK

    def day_sources(self, camera: str) -> list[Source]:
        """Return the sources by day of a camera; of all cameras where this one has none."""
        by_day = [source for source, one in self.recorded.items() if one.light == DAY]
        return [source for source in by_day if source.camera == camera] or by_day

    def ego_SE3_block(self, viewpoint: Viewpoint, source: Source) -> Tensor:  # noqa: N802
        """Return the pose (4, 4) of the block in the frame of the vehicle that carries a viewpoint's camera.

        Args:
            viewpoint: the camera.
            source: a recorded source of this camera, whose mounting it has.
        """
        mounting = torch.from_numpy(self.recorded[source].ego_SE3_camera)
        return (mounting @ viewpoint.viewmat.double()).float()

    def log_gain(self, colours: Tensor, source: Source) -> float:
        """Return the gain that the camera's controller chooses for rendered colours (H, W, 3), as a logarithm."""
        controller = self.controllers.get(group_of(source))
        if controller is None:
            return 0.0
        return controller.log_gain(
            light_features(self.response.exposed(colours[::EVERY_PX, ::EVERY_PX], source.camera))
        )

    @torch.no_grad()
    def respond(self, colours: Tensor, source: Source) -> Tensor:
        """Return the image (H, W, 3) that a camera takes of rendered colours, with the gain of its controller.

        Args:
            colours: (H, W, 3) rendered colours.
            source: the source whose camera, law of exposure and light the image has.
        """
        return self.response(colours, source.camera, self.log_gain(colours, source))

    def noise_at(self, source: Source, width_px: int) -> SensorNoise | None:
        """Return the noise of a source's images of a width; None where none was measured."""
        noise = self.noise.get(group_of(source))
        return None if noise is None else noise.scaled(width_px / self.width_px)

    def document(self) -> LightDocument:
        """Return everything that is not a tensor."""
        return LightDocument(
            cameras=[
                (*source, one.light, one.ego_SE3_camera.ravel().tolist()) for source, one in self.recorded.items()
            ],
            headlights=self.headlights is not None,
            controllers={group: law.numbers() for group, law in sorted(self.controllers.items())},
            noise={group: list(noise.deviations) for group, noise in sorted(self.noise.items())},
            width_px=self.width_px,
        )


def light_from(document: LightDocument) -> RecordedLight:
    """Return the light that a document describes; its tensors have the numbers before training."""
    cameras = [
        RecordedCamera(Source(traversal, camera), light, np.array(mounting).reshape(4, 4))
        for traversal, camera, light, mounting in document.cameras
    ]
    light = RecordedLight(cameras, headlights=document.headlights)
    light.controllers = {group: controller_from(numbers) for group, numbers in document.controllers.items()}
    light.noise = {group: SensorNoise(tuple(numbers)) for group, numbers in document.noise.items()}
    light.width_px = document.width_px
    return light
