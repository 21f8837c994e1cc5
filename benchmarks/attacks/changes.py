"""Changes of a render that show nothing more of the scene: recolouring, smoothing, mixing."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from mirror.arrays import Float64, UInt8
from mirror_baselines.grey_frame import luma_image
from mirror_baselines.smoothed_nearest_frame import smooth_image


@dataclass(frozen=True)
class Material:
    """A participant's knowledge of a view.

    Attributes:
        render: (H, W, 3) the honest render.
        nearest: (H, W, 3) the image of the nearest training camera.
        mean: (H, W, 3) the mean of the camera's training images.
    """

    render: UInt8
    nearest: UInt8
    mean: UInt8


Change = Callable[[Material], UInt8]


def to_levels(image: Float64) -> UInt8:
    """Round to levels of 8 bits, and clip."""
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def blur(image: Float64, sigma_px: float) -> Float64:
    """Smooth an image (H, W) or (H, W, C) by a gaussian; 0: not at all."""
    if sigma_px == 0.0:
        return image
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px, borderType=cv2.BORDER_REFLECT))


def luma(image: UInt8) -> Float64:
    """Return the luma (H, W) of ITU-R BT.601 of an image (H, W, 3)."""
    return np.asarray(image @ np.array([0.299, 0.587, 0.114]))


def _ramps(image: UInt8) -> tuple[Float64, Float64]:
    """Ramps (H, W) from 0 to 1 along columns and rows."""
    rows, columns = np.mgrid[: image.shape[0], : image.shape[1]]
    return columns / image.shape[1], rows / image.shape[0]


def _channels(*channels: Float64) -> UInt8:
    return to_levels(np.stack(channels, axis=2))


def _in_all(channel: int) -> Change:
    return lambda one: np.repeat(one.render[..., channel : channel + 1], 3, axis=2)


def _blurred(sigma_px: float) -> Change:
    return lambda one: to_levels(blur(one.render.astype(np.float64), sigma_px))


def _mixed(name: str, share: float) -> Change:
    return lambda one: to_levels((1 - share) * one.render + share * getattr(one, name).astype(np.float64))


def _ramps_and_luma(one: Material) -> UInt8:
    across, down = _ramps(one.render)
    return _channels(10 + 230 * across, 10 + 230 * down, luma(one.render))


def _luma_difference_ramp(one: Material) -> UInt8:
    values = one.render.astype(np.float64)
    down = 10 + 230 * _ramps(one.render)[1]
    return _channels(luma(one.render), 128 + (values[..., 2] - values[..., 0]) / 2, down)


def _luma_blur_mean(one: Material) -> UInt8:
    return _channels(luma(one.render), blur(luma(one.render), 2.0), luma(one.mean))


def _luma_blue_mean(one: Material) -> UInt8:
    return _channels(luma(one.render), one.render[..., 2].astype(np.float64), luma(one.mean))


def _three_blurs(one: Material) -> UInt8:
    blue = one.render[..., 2].astype(np.float64)
    return _channels(blue, blur(blue, 1.0), blur(blue, 4.0))


def _with_sky(one: Material) -> UInt8:
    step = 1.0 / (1.0 + np.exp((_ramps(one.render)[1] - 0.45) * 12))
    return to_levels(0.8 * one.render + 55.0 * step[..., None])


def _sharpened(one: Material) -> UInt8:
    values = one.render.astype(np.float64)
    return to_levels(2 * values - blur(values, 1.0))


RECOLOURED: Final[Mapping[str, Change]] = {
    "x ramp, y ramp, luma": _ramps_and_luma,
    "luma, B - R, y ramp": _luma_difference_ramp,
    "luma, blurred luma, camera mean": _luma_blur_mean,
    "luma, blue, camera mean": _luma_blue_mean,
    "blue, blurred by 0, 1 and 4 px": _three_blurs,
    "luma in all channels": lambda one: luma_image(one.render),
    "red in all channels": _in_all(0),
    "green in all channels": _in_all(1),
    "blue in all channels": _in_all(2),
    "20 levels brighter at the top": lambda one: to_levels(one.render + 20 * (0.5 - _ramps(one.render)[1])[..., None]),
    "a step like a sky": _with_sky,
    "doubled saturation": lambda one: to_levels(2.0 * one.render - luma(one.render)[..., None]),
    "gamma 0.6": lambda one: to_levels(255.0 * (one.render / 255.0) ** 0.6),
}
SMOOTHED: Final[Mapping[str, Change]] = {
    "blur of 0.5 px": _blurred(0.5),
    "blur of 1 px": _blurred(1.0),
    "blur of 2 px": _blurred(2.0),
    "luma blurred by 6 px, colours by 30": lambda one: smooth_image(one.render, 6.0, 30.0),
    "median of 3 x 3": lambda one: np.asarray(cv2.medianBlur(one.render, 3)),
    "bilateral filter": lambda one: np.asarray(cv2.bilateralFilter(one.render, 5, 30.0, 3.0)),
    "sharpened": _sharpened,
}
MIXED: Final[Mapping[str, Change]] = {
    "30 % camera mean": _mixed("mean", 0.3),
    "30 % nearest image": _mixed("nearest", 0.3),
}
CHANGES: Final[Mapping[str, Change]] = {**RECOLOURED, **SMOOTHED, **MIXED}
"""Changes that are made without the truth, by name."""

NOTHING: Final[Mapping[str, Change]] = {
    "grey": lambda one: np.full_like(one.render, 128),
    "mean colour": lambda one: np.broadcast_to(to_levels(one.mean.mean(axis=(0, 1))), one.render.shape).copy(),
    "camera mean": lambda one: one.mean,
}
"""Renders that show nothing of the place, by name."""
