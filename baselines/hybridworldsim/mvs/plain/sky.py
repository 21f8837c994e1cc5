"""Masks of the sky in plain torch, on any device; `hybridworldsim.mvs.sky` has the same steps by OpenCV."""

from __future__ import annotations

from typing import Final

import torch
from torch import Tensor

from hybridworldsim.mvs.sky_rules import RULES

_SRGB_TO_XYZ: Final = ((0.412453, 0.357580, 0.180423), (0.212671, 0.715160, 0.072169), (0.019334, 0.119193, 0.950227))
_WHITE: Final = (0.950456, 1.0, 1.088754)
_LINEAR: Final = 0.008856
_BESIDE: Final = ((0, 1), (0, -1), (1, 0), (-1, 0))
_AROUND: Final = (*_BESIDE, (1, 1), (1, -1), (-1, 1), (-1, -1))


def find_sky(rgb: Tensor, valid: Tensor, depth_m: Tensor, rise: Tensor) -> Tensor:
    """Find the pixels (H, W) that show the sky.

    Args:
        rgb: (H, W, 3) uint8.
        valid: (H, W) bool.
        depth_m: (H, W) depths that other images confirm; NaN where unknown.
        rise: (H, W) upward component of the unit rays, float64.
    """
    open_sky = (rise > RULES.min_rise) & valid & depth_m.isnan()
    lab = _fill_invalid(to_lab(rgb), valid)
    part = label_parts(open_sky & (_compute_deviation(lab[..., 0]) < RULES.max_deviation), _BESIDE)
    seeds = _select_sky_parts(part, lab, valid)[part] & (part < part.numel())
    nearness = _max_colour_distance(lab[..., 0][seeds].mean())
    similar = open_sky & ((lab - _smooth_seed_colour(lab, seeds)).norm(dim=2) < nearness)
    whole = label_parts(similar | seeds, _AROUND)
    kept = torch.zeros(whole.numel() + 1, dtype=torch.bool, device=rgb.device)
    kept[whole[seeds]] = True
    return kept[whole]


def to_lab(rgb: Tensor) -> Tensor:
    """Convert sRGB (H, W, 3) uint8 to CIE Lab in the 8-bit levels of OpenCV, float32: 2.55 L, a + 128, b + 128."""
    levels = rgb.double() / 255.0
    light = torch.where(levels <= 0.04045, levels / 12.92, ((levels + 0.055) / 1.055) ** 2.4)
    red, green, blue = light.unbind(2)
    mixed = [(a * red + b * green + c * blue) / white for (a, b, c), white in zip(_SRGB_TO_XYZ, _WHITE, strict=True)]
    xyz = torch.stack(mixed, 2)
    curved = torch.where(xyz > _LINEAR, xyz.clamp_min(_LINEAR) ** (1.0 / 3.0), 7.787 * xyz + 16.0 / 116.0)
    x, y, z = curved.unbind(2)
    lab = torch.stack(((116.0 * y - 16.0) * 2.55, 500.0 * (x - y) + 128.0, 200.0 * (y - z) + 128.0), 2)
    return lab.clamp(0.0, 255.0).round().float()


def label_parts(mask: Tensor, steps: tuple[tuple[int, int], ...]) -> Tensor:
    """Label the connected parts of a mask (H, W): by the index of their first pixel; H * W outside the mask.

    Labels spread to neighbours and along the labels that they name, so that rounds grow with the logarithm of a
    part's size; each round waits for the device.

    Args:
        mask: the mask.
        steps: rows and columns to the neighbours of a pixel.
    """
    (height, width), none = mask.shape, mask.numel()
    own = torch.arange(none, device=mask.device).view(height, width)
    labels = torch.where(mask, own, none)
    while True:
        framed = torch.nn.functional.pad(labels, (1, 1, 1, 1), value=none)
        least = labels
        for row, column in steps:
            least = torch.minimum(least, framed[1 + row : 1 + row + height, 1 + column : 1 + column + width])
        least = torch.where(mask, least, none)
        named = torch.arange(none + 1, device=mask.device)
        named.scatter_reduce_(0, labels.reshape(-1), least.reshape(-1), "amin")
        named[none] = none
        found = named[named[least]]
        if torch.equal(found, labels):
            return labels
        labels = found


def _fill_invalid(lab: Tensor, valid: Tensor) -> Tensor:
    weight = valid.float()
    mean = _blur(lab * weight[..., None], 4) / _blur(weight[..., None], 4).clamp_min(1e-6)
    return torch.where(valid[..., None], lab, mean)


def _compute_deviation(values: Tensor) -> Tensor:
    mean = _blur(values[..., None], 1)
    return (_blur((values * values)[..., None], 1) - mean * mean).clamp_min(0.0).sqrt()[..., 0]


def _select_sky_parts(part: Tensor, lab: Tensor, valid: Tensor) -> Tensor:
    """Mark the labels (H * W + 1,) of the parts in the colour of the best one that reach the upper rim."""
    count, flat = part.numel() + 1, part.reshape(-1)
    size = torch.bincount(flat, minlength=count)
    total = torch.zeros(count, 3, dtype=torch.float64, device=lab.device)
    mean = (total.index_add_(0, flat, lab.reshape(-1, 3).double()) / size.clamp_min(1)[:, None]).float()
    rim = torch.zeros(count, dtype=torch.bool, device=lab.device)
    # A column without a valid pixel has its first pixel here, which is in no part.
    rim[part.gather(0, valid.to(torch.uint8).argmax(0)[None])[0]] = True
    rim[count - 1] = False
    kept = rim & (size >= RULES.min_part_px)
    blue = RULES.neutral - mean[:, 2]
    best = torch.where(kept, mean[:, 0] + RULES.blue_weight * blue, -torch.inf).argmax()
    lightness = torch.where(valid, lab[..., 0], torch.nan)
    is_light = ~(mean[best, 0] < lightness.nanquantile(RULES.lightness_quantile))
    distance = (mean - mean[best]).norm(dim=1)
    return kept & (is_light | (blue[best] >= RULES.min_blue)) & (distance < 2.0 * _max_colour_distance(mean[best, 0]))


def _max_colour_distance(lightness: Tensor) -> Tensor:
    return (RULES.colour_distance_share * (lightness - RULES.dark_lightness)).clamp(*RULES.colour_distances)


def _smooth_seed_colour(lab: Tensor, seeds: Tensor) -> Tensor:
    side = max(lab.shape[:2]) // 4 * 2 + 1
    steps = torch.arange(side, dtype=torch.float64, device=lab.device) - side // 2
    window = torch.exp(-0.5 * (steps / (side / 4.0)) ** 2)
    weight = seeds[..., None].float()
    total, colour = (_convolve(image, window / window.sum()) for image in (weight, lab * weight))
    mean = lab[seeds].mean(0)
    return (colour + 1e-4 * mean) / (total + 1e-4)


def _blur(image: Tensor, reach: int) -> Tensor:
    """Average windows of 2 reach + 1 pixels of an image (H, W, C)."""
    side = 2 * reach + 1
    return _convolve(image, torch.full((side,), 1.0 / side, dtype=torch.float64, device=image.device))


def _convolve(image: Tensor, window: Tensor) -> Tensor:
    """Convolve an image (H, W, C) with a window (odd,) along both axes; the image is mirrored at its border pixels."""
    down, across = (_band_matrix(side, window) for side in image.shape[:2])
    return torch.einsum("ij,jkc,lk->ilc", down, image.double(), across).float()


def _band_matrix(side: int, window: Tensor) -> Tensor:
    """Return the matrix (side, side), float64, that convolves a line of pixels."""
    reach = len(window) // 2
    period = max(2 * side - 2, 1)
    pixel = torch.arange(side, device=window.device)[:, None]
    taken = (pixel + torch.arange(-reach, reach + 1, device=window.device)) % period
    taken = torch.minimum(taken, period - taken)
    matrix = torch.zeros(side, side, dtype=torch.float64, device=window.device)
    return matrix.scatter_add_(1, taken.clamp_(0, side - 1), window.expand(side, -1))
