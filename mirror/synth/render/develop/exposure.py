"""The automatic exposure of a camera, as a gain."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from mirror.arrays import Float32, Records
from mirror.portable import arrays, scalars
from mirror.synth.light.condition import Effects
from mirror.synth.render.develop.camera_response import CameraResponse

_EVERY_PX: Final = 4
_LUMINANCE: Final = np.array([0.2126, 0.7152, 0.0722], np.float32)
_ADAPTS: Final = 0.75
_AT_MOST: Final = 2.3
_AT_NIGHT: Final = 3.4
_HIGHLIGHTS: Final = 0.95
_HIGHLIGHT_AT: Final = 2.2
_DARKEST: Final = 1e-5


def compute_exposure(radiance: Float32, record: Records, response: CameraResponse, effects: Effects) -> float:
    """Compute the exposure gain of an image.

    The gain moves the geometric mean of the luminance most of the way to the condition's mean and protects
    highlights. It differs from the condition's exposure by at most a factor of 2.3, at night by at most 3.4 upwards.

    Args:
        radiance: (H, W, 3) radiance.
        record: LIGHTING record.
        response: the camera's response to light.
        effects: effects; without ``exposure`` the gain is that of the condition.
    """
    usual = float(record["exposure"])
    if not effects.exposure:
        return usual
    luminance = arrays.matmul(radiance[::_EVERY_PX, ::_EVERY_PX].reshape(-1, 3), _LUMINANCE)
    mean = float(arrays.exp(arrays.log(np.maximum(luminance, _DARKEST)).mean(dtype=np.float64)))
    gain = scalars.power(float(record["middle"]) / mean, _ADAPTS)
    last = int(_HIGHLIGHTS * (len(luminance) - 1))
    bright = float(np.partition(luminance, last)[last])
    if bright * usual * gain > _HIGHLIGHT_AT:
        gain *= math.sqrt(_HIGHLIGHT_AT / (bright * usual * gain))
    most = _AT_MOST + (_AT_NIGHT - _AT_MOST) * float(record["dark"])
    return usual * float(np.clip(gain, 1.0 / _AT_MOST, most) * scalars.power(2.0, response.exposure_ev))
