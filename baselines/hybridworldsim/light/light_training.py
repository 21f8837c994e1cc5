"""Training of a block's light: gains of its images, laws of exposure, noise."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.light.exposure_controller import EVERY_PX, FEATURES, fit_controllers, light_features
from hybridworldsim.light.exposure_gains import ExposureGains, estimate_log_gain
from hybridworldsim.light.recorded_light import RecordedLight, group_of
from hybridworldsim.light.sensor_noise import NoiseSamples, SensorNoise
from hybridworldsim.trainable.training_image import TrainingImage
from mirror.arrays import Float64

BEGIN: Final = 0.1
"""Progress before which all gains are one, because the street does not yet look like its images."""
_NOISE_IMAGES: Final = 8
"""Number of images of a group in which noise is measured."""


class LightTraining:
    """The light of a block while it is trained.

    Args:
        light: the light, changed in place.
    """

    def __init__(self, light: RecordedLight) -> None:
        self.light = light
        self._gains = ExposureGains()
        self._seen: dict[str, tuple[str, Float64]] = {}
        self._noise: dict[str, NoiseSamples] = {}

    def respond(self, colours: Tensor, image: TrainingImage, progress: float) -> Tensor:
        """Return the image (H, W, 3) of rendered colours (H, W, 3) at the gain of a training image, with gradients.

        The gain is estimated from the two images, and the light is recorded for the law of exposure.
        """
        source = image.viewpoint.source
        group = group_of(source)
        self._measure_noise(group, image)
        if progress < BEGIN:
            return colours
        response = self.light.response
        with torch.no_grad():
            rendered, rgb, scored = (one.detach()[::EVERY_PX, ::EVERY_PX] for one in (colours, image.rgb, image.scored))
            exposed = response.exposed(rendered, source.camera)
            light = response.curve.invert(rgb, response.row(source.camera))
            estimate = estimate_log_gain(rgb, rendered, light, exposed, scored)
            self._seen[image.name] = group, light_features(exposed)
        if estimate is not None:
            self._gains.update(image.name, group, estimate)
        return response(colours, source.camera, self._gains.log_gain(image.name, group))

    def log_gain(self, name: str, group: str) -> float:
        """Return the logarithm of the gain of a training image."""
        return self._gains.log_gain(name, group)

    def finish(self) -> None:
        """Fit the laws of exposure and the noise, and store them with the light."""
        self.light.controllers = fit_controllers(
            {
                name: (group, features, self._gains.log_gain(name, group))
                for name, (group, features) in self._seen.items()
            }
        )
        fitted = {group: samples.fit() for group, samples in self._noise.items()}
        self.light.noise = {group: noise for group, noise in fitted.items() if isinstance(noise, SensorNoise)}

    def state(self) -> dict[str, Tensor]:
        """Return everything that training needs to continue exactly, as tensors."""
        names = list(self._seen)
        rows = np.array([self._seen[name][1] for name in names]).reshape(-1, FEATURES)
        text = "\n".join(f"{name}\t{self._seen[name][0]}" for name in names)
        state = {f"gains.{key}": table for key, table in self._gains.state().items()}
        state |= {"seen": _to_bytes(text), "features": torch.from_numpy(rows)}
        state |= {"noise": _to_bytes("\n".join(self._noise)), "width": torch.tensor(self.light.width_px)}
        for number, samples in enumerate(self._noise.values()):
            state[f"noise.{number}"] = torch.from_numpy(samples.table())
        return state

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Restore what `state` returned."""
        prefix = "gains."
        self._gains.restore({key.removeprefix(prefix): one for key, one in state.items() if key.startswith(prefix)})
        pairs = [line.split("\t") for line in _to_text(state["seen"]).splitlines()]
        self._seen = {name: (group, row) for (name, group), row in zip(pairs, state["features"].numpy())}
        self._noise = {
            group: NoiseSamples(state[f"noise.{number}"].numpy())
            for number, group in enumerate(_to_text(state["noise"]).splitlines())
        }
        self.light.width_px = int(state["width"])

    def _measure_noise(self, group: str, image: TrainingImage) -> None:
        samples = self._noise.setdefault(group, NoiseSamples())
        if len(samples) < _NOISE_IMAGES:
            self.light.width_px = image.rgb.shape[1]
            samples.add(image.rgb.cpu().numpy(), image.scored.cpu().numpy())


def _to_bytes(text: str) -> Tensor:
    return torch.tensor(list(text.encode()), dtype=torch.uint8)


def _to_text(encoded: Tensor) -> str:
    return bytes(encoded.tolist()).decode()
