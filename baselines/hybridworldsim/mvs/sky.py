"""The sky of a picture, without weights: smooth, upward, open to the top, and of the colour that a sky has.

Weak evidence, and measured as such (docs/initialisation.md): a plain wall that fills a picture's upper rim has it all.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from hybridworldsim.mvs.estimator import StereoImage
from mirror.arrays import Bool, Float32, Float64, Int32

_LEAST_RISE: Final = 0.03
_SMOOTH: Final = 2.0
_ALIKE: Final = (3.0, 22.0)
_DARK: Final = 20.0
_ALIKE_SHARE: Final = 0.2
_BLUE: Final = 6.0
_LIGHTER_THAN: Final = 0.6
_LEAST_BLUE: Final = 4.0
_LEAST_PX: Final = 12
_NEUTRAL: Final = 128.0


@dataclass(frozen=True, eq=False)
class _Parts:
    """Smooth parts of a picture that reach its upper rim, by number; 0 is none of them."""

    number: Int32
    lab: Float32


def find_sky(picture: StereoImage, depth_m: Float32) -> Bool:
    """Pixels (H, W) that show the sky.

    Args:
        picture: the picture.
        depth_m: (H, W) depths that other pictures confirm; NaN where there is none.
    """
    open_sky = (compute_ray_rise(picture) > _LEAST_RISE) & picture.valid & np.isnan(depth_m)
    if not open_sky.any():
        return open_sky
    lab = _filled(cv2.cvtColor(picture.rgb, cv2.COLOR_RGB2LAB).astype(np.float32), picture.valid)
    parts = _parts(open_sky & (_deviation(lab[..., 0]) < _SMOOTH), lab, picture.valid)
    chosen = _of_sky_colour(parts, lab[picture.valid, 0])
    seeds = np.isin(parts.number, chosen)
    if not seeds.any():
        return seeds
    like = open_sky & (np.linalg.norm(lab - _colour_round(lab, seeds), axis=2) < _alike(lab[seeds, 0].mean()))
    return _joined(like | seeds, seeds)


def compute_ray_rise(picture: StereoImage) -> Float64:
    """The upward part (H, W) of the unit rays of all pixels."""
    height, width = picture.valid.shape
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(picture.K).T
    up = picture.world_SE3_camera.matrix()[0, 2, :3]
    return np.asarray(rays @ up / np.linalg.norm(rays, axis=2))


def _filled(lab: Float32, valid: Bool) -> Float32:
    """The picture with what is not valid in the colours round it, so that a border is no edge."""
    weight = valid.astype(np.float32)
    total = cv2.blur(weight, (9, 9))
    mean = cv2.blur(lab * weight[..., None], (9, 9)) / np.maximum(total, 1e-6)[..., None]
    return np.where(valid[..., None], lab, mean)


def _deviation(values: Float32) -> Float32:
    mean = cv2.blur(values, (3, 3))
    return np.asarray(np.sqrt(np.maximum(cv2.blur(values * values, (3, 3)) - mean * mean, 0.0)))


def _parts(smooth: Bool, lab: Float32, valid: Bool) -> _Parts:
    count, number = cv2.connectedComponents(smooth.astype(np.uint8), connectivity=4)
    columns = np.flatnonzero(valid.any(axis=0))
    rim = np.bincount(number[np.argmax(valid, axis=0)[columns], columns], minlength=count)
    size = np.bincount(number.ravel(), minlength=count)
    kept = (rim > 0) & (size >= _LEAST_PX)
    kept[0] = False
    label = np.cumsum(kept) * kept
    number = label[number].astype(np.int32)
    mean = np.stack([np.bincount(number.ravel(), lab[..., axis].ravel()) for axis in range(3)], axis=1)
    return _Parts(number, (mean / np.maximum(np.bincount(number.ravel()), 1)[:, None])[1:].astype(np.float32))


def _of_sky_colour(parts: _Parts, lightness: Float32) -> Int32:
    """Numbers of the parts that have the colour of the one that is most like a sky: light, or blue in the dark."""
    if not len(parts.lab):
        return np.empty(0, np.int32)
    blue = _NEUTRAL - parts.lab[:, 2]
    score = parts.lab[:, 0] + _BLUE * blue
    best = int(np.argmax(score))
    if parts.lab[best, 0] < np.quantile(lightness, _LIGHTER_THAN) and blue[best] < _LEAST_BLUE:
        return np.empty(0, np.int32)
    alike = np.linalg.norm(parts.lab - parts.lab[best], axis=1) < 2.0 * _alike(parts.lab[best, 0])
    return (np.flatnonzero(alike) + 1).astype(np.int32)


def _alike(lightness: float) -> float:
    """How far apart colours of one sky are: in the dark all colours are near each other."""
    return float(np.clip(_ALIKE_SHARE * (lightness - _DARK), *_ALIKE))


def _colour_round(lab: Float32, seeds: Bool) -> Float32:
    """The colour (H, W, 3) of the seeds round each pixel: near the horizon the sky is another than above."""
    weight = seeds.astype(np.float32)
    side = max(lab.shape[:2]) // 4 * 2 + 1
    total = cv2.GaussianBlur(weight, (side, side), side / 4.0)
    colour = cv2.GaussianBlur(lab * weight[..., None], (side, side), side / 4.0)
    mean = lab[seeds].mean(axis=0)
    return np.asarray((colour + 1e-4 * mean) / (total + 1e-4)[..., None], np.float32)


def _joined(mask: Bool, seeds: Bool) -> Bool:
    """The parts of a mask that hold a seed."""
    count, part = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    kept = np.zeros(count, np.bool_)
    kept[part[seeds]] = True
    kept[0] = False
    return np.asarray(kept[part])
