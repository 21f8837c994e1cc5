"""Finds the sky of an image without a network: smooth parts above the horizon at the upper rim, in the colour of a sky.

The evidence is weak (docs/initialisation/accuracy.md has figures): a plain wall at the upper rim of an image
satisfies it too.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from hybridworldsim.kernels.dispatch import runs_kernels
from hybridworldsim.mvs.estimator import StereoImage
from hybridworldsim.mvs.sky_rules import RULES
from mirror.arrays import Bool, Float32, Float64, Int32
from mirror.devices import CPU


@dataclass(frozen=True, eq=False)
class _Parts:
    """Smooth parts of an image that reach its upper rim.

    Attributes:
        number: (H, W) number of the part; 0: no part.
        lab: (P, 3) mean CIE Lab colour of each part.
    """

    number: Int32
    lab: Float32


def find_sky(image: StereoImage, depth_m: Float32, device: str = CPU) -> Bool:
    """Find the pixels (H, W) that show the sky.

    Args:
        image: the image.
        depth_m: (H, W) depths that other images confirm, metres; NaN where unknown.
        device: where it is computed, as torch names it: on the CPU by OpenCV, elsewhere in plain torch.
    """
    if not runs_kernels(device):
        return _find_elsewhere(image, depth_m, device)
    open_sky = (compute_ray_rise(image) > RULES.min_rise) & image.valid & np.isnan(depth_m)
    if not open_sky.any():
        return open_sky
    lab = _fill_invalid(cv2.cvtColor(image.rgb, cv2.COLOR_RGB2LAB).astype(np.float32), image.valid)
    parts = _find_parts(open_sky & (_compute_deviation(lab[..., 0]) < RULES.max_deviation), lab, image.valid)
    chosen = _select_sky_parts(parts, lab[image.valid, 0])
    seeds = np.isin(parts.number, chosen)
    if not seeds.any():
        return seeds
    similar = open_sky & (
        np.linalg.norm(lab - _smooth_seed_colour(lab, seeds), axis=2) < _max_colour_distance(lab[seeds, 0].mean())
    )
    return _keep_seeded_parts(similar | seeds, seeds)


def _find_elsewhere(image: StereoImage, depth_m: Float32, device: str) -> Bool:
    """Find the sky in plain torch."""
    import torch

    from hybridworldsim.mvs.plain.sky import find_sky as find_plainly

    arrays = image.rgb, image.valid, depth_m, compute_ray_rise(image)
    found = find_plainly(*(torch.from_numpy(np.ascontiguousarray(array)).to(device) for array in arrays))
    return np.asarray(found.cpu().numpy())


def compute_ray_rise(image: StereoImage) -> Float64:
    """Compute the upward component (H, W) of the unit rays of all pixels."""
    height, width = image.valid.shape
    u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(image.K).T
    up = image.world_SE3_camera.matrix()[0, 2, :3]
    return np.asarray(rays @ up / np.linalg.norm(rays, axis=2))


def _fill_invalid(lab: Float32, valid: Bool) -> Float32:
    """Fill invalid pixels with the mean of the valid pixels around, so that the border of the mask is no edge."""
    weight = valid.astype(np.float32)
    total = cv2.blur(weight, (9, 9))
    mean = cv2.blur(lab * weight[..., None], (9, 9)) / np.maximum(total, 1e-6)[..., None]
    return np.where(valid[..., None], lab, mean)


def _compute_deviation(values: Float32) -> Float32:
    """Compute the standard deviation of each 3 x 3 window."""
    mean = cv2.blur(values, (3, 3))
    return np.asarray(np.sqrt(np.maximum(cv2.blur(values * values, (3, 3)) - mean * mean, 0.0)))


def _find_parts(smooth: Bool, lab: Float32, valid: Bool) -> _Parts:
    """Find connected smooth parts that reach the upper rim of the valid pixels."""
    count, number = cv2.connectedComponents(smooth.astype(np.uint8), connectivity=4)
    columns = np.flatnonzero(valid.any(axis=0))
    rim = np.bincount(number[np.argmax(valid, axis=0)[columns], columns], minlength=count)
    size = np.bincount(number.ravel(), minlength=count)
    kept = (rim > 0) & (size >= RULES.min_part_px)
    kept[0] = False
    label = np.cumsum(kept) * kept
    number = label[number].astype(np.int32)
    mean = np.stack([np.bincount(number.ravel(), lab[..., axis].ravel()) for axis in range(3)], axis=1)
    return _Parts(number, (mean / np.maximum(np.bincount(number.ravel()), 1)[:, None])[1:].astype(np.float32))


def _select_sky_parts(parts: _Parts, lightness: Float32) -> Int32:
    """Select the parts in the colour of the best one; a sky is light, or blue in the dark."""
    if not len(parts.lab):
        return np.empty(0, np.int32)
    blue = RULES.neutral - parts.lab[:, 2]
    score = parts.lab[:, 0] + RULES.blue_weight * blue
    best = int(np.argmax(score))
    if parts.lab[best, 0] < np.quantile(lightness, RULES.lightness_quantile) and blue[best] < RULES.min_blue:
        return np.empty(0, np.int32)
    similar = np.linalg.norm(parts.lab - parts.lab[best], axis=1) < 2.0 * _max_colour_distance(parts.lab[best, 0])
    return (np.flatnonzero(similar) + 1).astype(np.int32)


def _max_colour_distance(lightness: float) -> float:
    """Compute the greatest colour distance within one sky; dark colours lie closer together."""
    return float(np.clip(RULES.colour_distance_share * (lightness - RULES.dark_lightness), *RULES.colour_distances))


def _smooth_seed_colour(lab: Float32, seeds: Bool) -> Float32:
    """Compute the colour (H, W, 3) of the seeds around each pixel, because the sky changes towards the horizon."""
    weight = seeds.astype(np.float32)
    side = max(lab.shape[:2]) // 4 * 2 + 1
    total = cv2.GaussianBlur(weight, (side, side), side / 4.0)
    colour = cv2.GaussianBlur(lab * weight[..., None], (side, side), side / 4.0)
    mean = lab[seeds].mean(axis=0)
    return np.asarray((colour + 1e-4 * mean) / (total + 1e-4)[..., None], np.float32)


def _keep_seeded_parts(mask: Bool, seeds: Bool) -> Bool:
    """Keep the connected parts of a mask that contain a seed."""
    count, part = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
    kept = np.zeros(count, np.bool_)
    kept[part[seeds]] = True
    kept[0] = False
    return np.asarray(kept[part])
