"""The comparison of depth maps in plain torch, on any device; `hybridworldsim.mvs.fusion` has the compiled kernel."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class OtherDepth:
    """A depth map that a reference is compared with, and the motions between both: ``z A (u, v, 1) + b``, in pixels.

    Attributes:
        depth_m: (H', W') along the camera's z axis; NaN where unknown.
        forth: (3, 3) A from pixels of the reference to pixels of the other.
        forth_t: (3,) b of the same.
        back: (3, 3) A of the inverse.
        back_t: (3,) b of the same.
    """

    depth_m: Tensor
    forth: Tensor
    forth_t: Tensor
    back: Tensor
    back_t: Tensor


def find_agreeing(reference: Tensor, other: OtherDepth, max_px: float, max_share: float) -> Tensor:
    """Return, for each pixel (H, W), the depth that another map gives it, float64; 0 where it gives none or disagrees.

    Args:
        reference: (H, W) depths; NaN where unknown.
        other: the other map.
        max_px: greatest distance of a reprojected point from its start, px.
        max_share: greatest difference of depths, as a share of the depth.
    """
    height, width = reference.shape
    rows, columns = other.depth_m.shape
    u = torch.arange(width, dtype=torch.float64, device=reference.device) + 0.5
    v = torch.arange(height, dtype=torch.float64, device=reference.device)[:, None] + 0.5
    z = reference.double()
    x, y, forth_z = _move(other.forth, other.forth_t, u, v, z)
    x, y = x / forth_z, y / forth_z
    # NaN compares false.
    inside = (z > 0.0) & (forth_z > 0.0) & (x >= 0.0) & (x < columns) & (y >= 0.0) & (y < rows)
    place = torch.where(inside, y, 0.0).long() * columns + torch.where(inside, x, 0.0).long()
    # The reprojection starts at the projected position with the depth of the pixel that contains it.
    other_z = other.depth_m.reshape(-1)[place].double()
    back_u, back_v, back_z = _move(other.back, other.back_t, x, y, other_z)
    du, dv = back_u / back_z - u, back_v / back_z - v
    agrees = (
        inside
        & (other_z > 0.0)
        & (back_z > 0.0)
        & ((back_z - z).abs() <= max_share * z)
        & (du * du + dv * dv <= max_px * max_px)
    )
    return torch.where(agrees, back_z, 0.0)


def _move(matrix: Tensor, shift: Tensor, u: Tensor, v: Tensor, z: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    x, y, depth = (z * (row[0] * u + row[1] * v + row[2]) + start for row, start in zip(matrix, shift))
    return x, y, depth
