"""The sky of a picture, without weights: smooth, upward, joined to the top, and nowhere confirmed to be near."""

from __future__ import annotations

from typing import Final

import cv2
import numpy as np

from hybridworldsim.mvs.estimator import PosedPicture
from mirror.arrays import Bool, Float32, Float64

_LEAST_RISE: Final = 0.03
_SURE_RISE: Final = 0.25
_SMOOTH: Final = 6.0
_COLOUR: Final = 14.0
_LEAST_SHARE: Final = 0.002


def sky_mask(picture: PosedPicture, depth_m: Float32) -> Bool:
    """Pixels (H, W) that show the sky.

    Where the picture is smooth, looks upwards and has no depth, parts that reach its upper rim are taken; then what
    looks like them beside them. A part must be brighter than what is below it, or, at night, as dark as anything.

    Args:
        picture: the picture.
        depth_m: (H, W) depths that other pictures confirm; NaN where there is none.
    """
    rise = _rise(picture)
    upward = (rise > _LEAST_RISE) & picture.valid & np.isnan(depth_m)
    if not upward.any():
        return upward
    lab = cv2.cvtColor(cv2.GaussianBlur(picture.rgb, (3, 3), 0), cv2.COLOR_RGB2LAB).astype(np.float32)
    smooth = upward & (_deviation(lab[..., 0]) < _SMOOTH)
    seeds = _reaching_the_top(smooth, picture.valid, rise)
    if seeds.sum() < _LEAST_SHARE * picture.valid.sum():
        return np.zeros_like(upward)
    rest = picture.valid & ~upward
    if not _lighter_or_dark(lab[..., 0], seeds, rest):
        return np.zeros_like(upward)
    like = upward & (np.abs(lab - _colour_of(lab, seeds)).max(axis=2) < _COLOUR)
    return _joined(like | seeds, seeds)


def _rise(picture: PosedPicture) -> Float64:
    """The upward part (H, W) of the unit rays of all pixels."""
    height, width = picture.valid.shape
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(picture.K).T
    up = picture.world_SE3_camera.matrix()[0, 2, :3]
    return np.asarray(rays @ up / np.linalg.norm(rays, axis=2))


def _deviation(values: Float32) -> Float32:
    mean = cv2.blur(values, (3, 3))
    return np.asarray(np.sqrt(np.maximum(cv2.blur(values * values, (3, 3)) - mean * mean, 0.0)))


def _reaching_the_top(smooth: Bool, valid: Bool, rise: Float64) -> Bool:
    """The parts of a mask that hold the topmost valid pixel of a column, or look steeply up."""
    count, part = cv2.connectedComponents(smooth.astype(np.uint8), connectivity=4)
    top = np.argmax(valid, axis=0)
    columns = np.flatnonzero(valid.any(axis=0))
    edge = np.zeros_like(smooth)
    edge[top[columns], columns] = True
    reached = np.zeros(count, np.bool_)
    reached[part[edge & smooth & (rise > _SURE_RISE / 2)]] = True
    reached[part[smooth & (rise > 2.0 * _SURE_RISE)]] = True
    reached[0] = False
    return np.asarray(reached[part])


def _lighter_or_dark(lightness: Float32, seeds: Bool, rest: Bool) -> bool:
    own = float(np.median(lightness[seeds]))
    if not rest.any():
        return True
    return own >= float(np.median(lightness[rest])) or own <= 70.0


def _colour_of(lab: Float32, seeds: Bool) -> Float32:
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
