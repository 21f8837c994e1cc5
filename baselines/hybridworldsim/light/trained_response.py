"""The response of cameras: what lies between the light of a street and an image of it."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from hybridworldsim.kernels.dispatch import is_compiled
from hybridworldsim.light.exposing import corner_squares, expose
from hybridworldsim.light.tone_curve import ToneCurve
from mirror.errors import UsageError


class TrainedResponse(nn.Module):
    """White balance, vignetting and tone curve of each camera.

    A street's colours are the image at gain one without vignetting: ``colour = f(light)``. An image at another gain is
    ``f(gain * white * vignetting * light)``. The three gains of the white balance have the product one, vignetting is
    one in the middle, and f(0.18) = 0.18: the mean of the light belongs to the street alone.

    Args:
        cameras: names of the cameras.
    """

    def __init__(self, cameras: Sequence[str]) -> None:
        super().__init__()
        self.cameras = tuple(cameras)
        self._rows = {camera: row for row, camera in enumerate(self.cameras)}
        self.curve = ToneCurve(len(self.cameras))
        self.white = nn.Parameter(torch.zeros(len(self.cameras), 3))
        self.falloff = nn.Parameter(torch.full((len(self.cameras),), 0.02))

    def row(self, camera: str) -> int:
        """Return the number of a camera.

        Raises:
            UsageError: the camera was not trained on.
        """
        if camera not in self._rows:
            raise UsageError(
                f"no response of camera {camera}", expected=f"one of {', '.join(self.cameras)}",
                remedy="name the camera as in the recordings that the model was trained on",
            )  # fmt: skip
        return self._rows[camera]

    def forward(self, colours: Tensor, camera: str, log_gain: float) -> Tensor:
        """Return the image (H, W, 3) that a camera takes of a street.

        Args:
            colours: (H, W, 3) rendered colours of the street, 0 or more.
            camera: name of the camera.
            log_gain: natural logarithm of the gain, relative to the mean of the camera's images in the appearance.
        """
        if not is_compiled(colours) or colours.dtype != torch.float32:
            return self.curve(self.exposed(colours, camera, log_gain), self.row(camera))
        row = self.row(camera)
        factors = (self.white[row] - self.white[row].mean() + log_gain) / math.log(2.0)
        return expose(colours, factors, self.falloff[row].clamp_min(0.0), *self.curve.knots(row))

    def exposed(self, colours: Tensor, camera: str, log_gain: float = 0.0) -> Tensor:
        """Return the light (H, W, 3) that reaches the sensor, times the gain; see `forward`."""
        row = self.row(camera)
        factor = torch.exp(self.white[row] - self.white[row].mean() + log_gain)
        vignetting = self.vignetting(row, colours.shape[0], colours.shape[1])
        return self.curve.invert(colours, row) * factor * vignetting[..., None]

    def vignetting(self, row: int, height: int, width: int) -> Tensor:
        """Return the share (H, W) of the light that reaches each pixel; one in the middle."""
        square = corner_squares(height, width).to(self.falloff.device)
        return (1.0 + self.falloff[row].clamp_min(0.0) * square).reciprocal().square()
