"""Sensors with a fault: changes of the images between the renderer and the policy, and of the cameras' mountings."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Final

import numpy as np

from hybridworldsim.simulator.policies.protocol import CameraSpec
from hybridworldsim.simulator.renderers.protocol import to_arrays, to_tensors
from mirror.arrays import UInt8
from mirror.geometry import Poses
from mirror.protocols.sensor_faults import SensorFault

if TYPE_CHECKING:
    from torch import Tensor

_GAMMA: Final = 2.2
_PURPOSE: Final = 0x5E4502
"""Separates the stream of the noise from the simulator's others."""


class FaultySensors:
    """The sensors of one drive.

    Args:
        fault: what is wrong with them; None: nothing.
        seed: seed of the drive.
    """

    def __init__(self, fault: SensorFault | None, seed: int) -> None:
        self._fault, self._seed = fault, seed
        steps = 0 if fault is None else fault.late_steps
        self._waiting: deque[dict[str, UInt8]] = deque(maxlen=steps + 1)
        levels = np.arange(256) / 255.0
        gain = 1.0 if fault is None else 2.0**fault.exposure_stops
        self._exposed = np.round(255.0 * np.clip(gain * levels**_GAMMA, 0.0, 1.0) ** (1.0 / _GAMMA)).astype(np.uint8)

    def turn(self, cameras: Mapping[str, CameraSpec]) -> dict[str, CameraSpec]:
        """Return the cameras as they are mounted; the policy gets the given ones as its specification."""
        if self._fault is None or self._fault.turned_deg == 0.0:
            return dict(cameras)
        half = 0.5 * np.radians(self._fault.turned_deg)
        turned = {}
        for name, spec in cameras.items():
            place = spec.ego_SE3_camera.translation
            turn = Poses(np.array([[np.cos(half), 0.0, 0.0, np.sin(half)]]), np.zeros((1, 3)))
            about = turn @ Poses(spec.ego_SE3_camera.rotation, np.zeros_like(place))
            turned[name] = replace(spec, ego_SE3_camera=Poses(about.rotation, place))
        return turned

    def change(self, images: Mapping[str, UInt8], step: int, time_s: float) -> dict[str, UInt8]:
        """Return the images (H, W, 3) that the policy gets; call it once a step, in order.

        Args:
            images: the images of a sound rig, by camera.
            step: number of the step.
            time_s: time of the drive.
        """
        fault = self._fault
        if fault is None:
            return dict(images)
        seen: dict[str, UInt8] = {}
        for number, (name, image) in enumerate(images.items()):
            if name in fault.dropped and time_s >= fault.after_s:
                seen[name] = np.zeros_like(image)
                continue
            changed = self._exposed[image] if fault.exposure_stops else image
            if fault.noise:
                generator = np.random.default_rng([_PURPOSE, self._seed, number, step])
                noisy = changed + fault.noise * generator.standard_normal(image.shape)
                changed = np.clip(np.round(noisy), 0.0, 255.0).astype(np.uint8)
            seen[name] = changed
        self._waiting.append(seen)
        if len(self._waiting) <= fault.late_steps:
            return {name: np.zeros_like(image) for name, image in seen.items()}
        return self._waiting[0]

    def change_tensors(self, images: Mapping[str, Tensor], step: int, time_s: float) -> dict[str, Tensor]:
        """Return what `change` returns, as tensors on the device of the images; without a fault they never leave it."""
        if self._fault is None:
            return dict(images)
        changed = to_tensors(self.change(to_arrays(images), step, time_s))
        return {name: image.to(images[name].device) for name, image in changed.items()}
