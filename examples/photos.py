"""What `train_lund.py` fits to: photos with the cameras that COLMAP found, undistorted and made smaller."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import torch
from torch import Tensor
from torch.nn.functional import conv2d


@dataclass(frozen=True, eq=False)
class Photos:
    """Photos of one size, by name.

    Attributes:
        names: of the files.
        pictures: (P, H, W, 3) in 0..1.
        viewmats: (P, 4, 4) camera from world.
        Ks: (P, 3, 3) pixels.
        points: (N, 3) that COLMAP triangulated.
        colors: (N, 3) of the points, in 0..1.
        extent: the largest distance of a camera from their middle.
    """

    names: list[str]
    pictures: Tensor
    viewmats: Tensor
    Ks: Tensor
    points: Tensor
    colors: Tensor
    extent: float


def load(folder: Path, width: int) -> Photos:
    """Read ``images/`` and ``colmap/`` of a folder; photos become `width` pixels wide and free of distortion."""
    model = pycolmap.Reconstruction(str(folder / "colmap"))
    images = sorted(model.images.values(), key=lambda image: image.name)
    pictures, viewmats, cameras = [], [], []
    for image in images:
        lens = model.cameras[image.camera_id]
        photo = cv2.imread(str(folder / "images" / image.name))
        straight = cv2.undistort(photo, lens.calibration_matrix(), np.array([lens.params[3], 0.0, 0.0, 0.0]))
        size = (width, round(width * lens.height / lens.width))
        pictures.append(cv2.cvtColor(cv2.resize(straight, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2RGB))
        viewmats.append(np.vstack([image.cam_from_world().matrix(), [0.0, 0.0, 0.0, 1.0]]))
        cameras.append(np.diag([size[0] / lens.width, size[1] / lens.height, 1.0]) @ lens.calibration_matrix())
    centres = np.stack([image.projection_center() for image in images])
    points = model.points3D.values()
    return Photos(
        [image.name for image in images],
        torch.from_numpy(np.stack(pictures)).float() / 255.0,
        torch.from_numpy(np.stack(viewmats)).float(),
        torch.from_numpy(np.stack(cameras)).float(),
        torch.from_numpy(np.stack([point.xyz for point in points])).float(),
        torch.from_numpy(np.stack([point.color for point in points])).float() / 255.0,
        float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()),
    )


def start(photos: Photos) -> tuple[dict[str, torch.nn.Parameter], dict[str, torch.optim.Adam]]:
    """Gaussians at the points, as large as the distance to the three nearest, and 3DGS's optimizers."""
    near = torch.cdist(photos.points, photos.points).topk(4, largest=False).values[:, 1:]
    size = near.square().mean(dim=1).sqrt().clamp_min(1e-4).log()
    count = len(photos.points)
    values = {
        "means": (photos.points, 1.6e-4 * photos.extent),
        "scales": (size[:, None].repeat(1, 3), 5e-3),
        "quats": (torch.rand(count, 4), 1e-3),
        "opacities": (torch.full((count,), math.log(0.1 / 0.9)), 5e-2),
        "sh0": (((photos.colors - 0.5) / 0.28209479)[:, None], 2.5e-3),
        "shN": (torch.zeros(count, 15, 3), 2.5e-3 / 20),
    }
    splats = {name: torch.nn.Parameter(value) for name, (value, _) in values.items()}
    optimizers = {name: torch.optim.Adam([splats[name]], lr=rate, eps=1e-15) for name, (_, rate) in values.items()}
    return splats, optimizers


def difference(one: Tensor, other: Tensor) -> Tensor:
    """3DGS's loss of two pictures (H, W, 3): 0.8 times the mean difference, 0.2 times one less their SSIM."""
    window = torch.softmax(-(torch.arange(11) - 5.0).square() / (2 * 1.5**2), dim=0)
    maps = torch.cat([one, other, one * one, other * other, one * other], dim=-1)  # (H, W, 15)
    maps = maps.permute(2, 0, 1)[None]  # a view: torch is fast with channels last, and slow without
    for shape in ((1, 1, 1, 11), (1, 1, 11, 1)):
        maps = conv2d(maps, window.view(shape).repeat(15, 1, 1, 1), groups=15)
    ma, mb, aa, bb, ab = maps[0].split(3)
    ssim = (2 * ma * mb + 1e-4) * (2 * (ab - ma * mb) + 9e-4)
    ssim = ssim / ((ma * ma + mb * mb + 1e-4) * (aa - ma * ma + bb - mb * mb + 9e-4))
    return 0.8 * (one - other).abs().mean() + 0.2 * (1 - ssim.mean())


def psnr(one: Tensor, other: Tensor) -> float:
    """Of two pictures in 0..1, dB."""
    return float(-10.0 * torch.log10((one - other).square().mean()))
