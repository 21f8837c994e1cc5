"""Photos and cameras for `train_lund.py`: reads a COLMAP model, undistorts and scales the photos."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
import torch
from torch import Tensor
from torch.nn import Parameter
from torch.nn.functional import conv2d
from torch.optim import Adam
from torch.optim.lr_scheduler import ExponentialLR

from mirror.errors import UsageError


@dataclass(frozen=True, eq=False)
class Photos:
    """Photos of one size, in order of their names.

    Attributes:
        names: file names.
        images: (P, H, W, 3) in 0..1.
        viewmats: (P, 4, 4) camera from world.
        Ks: (P, 3, 3) intrinsics, pixels.
        points: (N, 3) triangulated by COLMAP.
        colors: (N, 3) colours of the points, in 0..1.
        extent: largest distance of a camera from the mean position.
    """

    names: list[str]
    images: Tensor
    viewmats: Tensor
    Ks: Tensor
    points: Tensor
    colors: Tensor
    extent: float

    @property
    def width(self) -> int:
        """Width, pixels."""
        return self.images.shape[2]

    @property
    def height(self) -> int:
        """Height, pixels."""
        return self.images.shape[1]

    @property
    def test(self) -> list[int]:
        """Indices of the held-out photos: every eighth."""
        return list(range(7, len(self.names), 8))

    @property
    def train(self) -> list[int]:
        """Indices of the training photos."""
        return [index for index in range(len(self.names)) if index not in self.test]


class Progress:
    """Prints a table of PSNR by step, and saves renders of the held-out photos.

    Args:
        photos: the photos.
        render: renders the image (H, W, 3) of a photo's index; it may return more values.
        out: folder of the renders and ``curve.csv``.
    """

    def __init__(self, photos: Photos, render: Callable[[int], tuple[Tensor, Any]], out: Path) -> None:
        self._photos, self._render, self._out = photos, render, out
        self._begin = time.perf_counter()
        out.mkdir(parents=True, exist_ok=True)
        self._print("step,seconds,gaussians,train_psnr_db,test_psnr_db", "w")

    def report(self, step: int, gaussians: int) -> None:
        """Print the mean PSNR over the training photos and over the held-out photos."""
        seconds = time.perf_counter() - self._begin
        train, test = (sum(map(self._psnr, some)) / len(some) for some in (self._photos.train, self._photos.test))
        self._print(f"{step},{seconds:.0f},{gaussians},{train:.2f},{test:.2f}", "a")

    def save(self) -> None:
        """Save the renders of the held-out photos, and print their PSNR."""
        for index in self._photos.test:
            image = (self._render_image(index) * 255).round().byte().numpy()
            cv2.imwrite(str(self._out / self._photos.names[index]), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
            print(f"{self._photos.names[index]}: {self._psnr(index):.2f} dB")

    def _psnr(self, index: int) -> float:
        error = (self._render_image(index) - self._photos.images[index]).square().mean()
        return float(-10.0 * torch.log10(error))

    @torch.no_grad()
    def _render_image(self, index: int) -> Tensor:
        return self._render(index)[0].clamp(0.0, 1.0)

    def _print(self, line: str, mode: str) -> None:
        print(line, flush=True)
        with (self._out / "curve.csv").open(mode) as file:
            file.write(line + "\n")


def load(folder: Path, width: int) -> Photos:
    """Read ``images/`` and ``colmap/`` of a folder; undistort the photos and scale them to `width` pixels."""
    model = pycolmap.Reconstruction(str(folder / "colmap"))
    images = sorted(model.images.values(), key=lambda image: image.name)
    kinds = {
        (lens.model.name, lens.width, lens.height) for lens in (model.cameras[image.camera_id] for image in images)
    }
    if len(kinds) != 1 or {"SIMPLE_RADIAL"} != {name for name, _, _ in kinds}:
        raise UsageError(
            f"cameras are {sorted(kinds)}",
            file=folder / "colmap",
            expected="SIMPLE_RADIAL cameras of one size",
            remedy="let COLMAP fit that model to photos of one size, or undistort them",
        )
    pixels, viewmats, cameras = [], [], []
    for image in images:
        lens = model.cameras[image.camera_id]
        photo = cv2.imread(str(folder / "images" / image.name))
        undistorted = cv2.undistort(photo, lens.calibration_matrix(), np.array([lens.params[3], 0.0, 0.0, 0.0]))
        size = (width, round(width * lens.height / lens.width))
        pixels.append(cv2.cvtColor(cv2.resize(undistorted, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2RGB))
        viewmats.append(np.vstack([image.cam_from_world().matrix(), [0.0, 0.0, 0.0, 1.0]]))
        cameras.append(np.diag([size[0] / lens.width, size[1] / lens.height, 1.0]) @ lens.calibration_matrix())
    centres = np.stack([image.projection_center() for image in images])
    points = model.points3D.values()
    return Photos(
        [image.name for image in images],
        torch.from_numpy(np.stack(pixels)).float() / 255.0,
        torch.from_numpy(np.stack(viewmats)).float(),
        torch.from_numpy(np.stack(cameras)).float(),
        torch.from_numpy(np.stack([point.xyz for point in points])).float(),
        torch.from_numpy(np.stack([point.color for point in points])).float() / 255.0,
        float(np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()),
    )


def start(photos: Photos, steps: int) -> tuple[dict[str, Parameter], dict[str, Adam], ExponentialLR]:
    """Make Gaussians at the points, as large as the distance to the three nearest points, and 3DGS's optimizers."""
    nearest = torch.cdist(photos.points, photos.points).topk(4, largest=False).values[:, 1:]
    size = nearest.square().mean(dim=1).sqrt().clamp_min(1e-4).log()
    count = len(photos.points)
    values = {
        "means": (photos.points, 1.6e-4 * photos.extent),
        "scales": (size[:, None].repeat(1, 3), 5e-3),
        "quats": (torch.rand(count, 4), 1e-3),
        "opacities": (torch.full((count,), math.log(0.1 / 0.9)), 5e-2),
        "sh0": (((photos.colors - 0.5) / 0.28209479)[:, None], 2.5e-3),
        "shN": (torch.zeros(count, 15, 3), 2.5e-3 / 20),
    }
    splats = {name: Parameter(value) for name, (value, _) in values.items()}
    optimizers = {name: Adam([splats[name]], lr=rate, eps=1e-15) for name, (_, rate) in values.items()}
    return splats, optimizers, ExponentialLR(optimizers["means"], 0.01 ** (1 / steps))


def compute_loss(first: Tensor, second: Tensor) -> Tensor:
    """Compute 3DGS's loss of two images (H, W, 3): 0.8 L1 + 0.2 (1 - SSIM)."""
    window = torch.softmax(-(torch.arange(11) - 5.0).square() / (2 * 1.5**2), dim=0)
    maps = torch.cat([first, second, first * first, second * second, first * second], dim=-1)  # (H, W, 15)
    maps = maps.permute(2, 0, 1)[None]  # a view: torch is fast with channels last, and slow without
    for shape in ((1, 1, 1, 11), (1, 1, 11, 1)):
        maps = conv2d(maps, window.view(shape).repeat(15, 1, 1, 1), groups=15)
    ma, mb, aa, bb, ab = maps[0].split(3)
    ssim = (2 * ma * mb + 1e-4) * (2 * (ab - ma * mb) + 9e-4)
    ssim = ssim / ((ma * ma + mb * mb + 1e-4) * (aa - ma * ma + bb - mb * mb + 9e-4))
    return 0.8 * (first - second).abs().mean() + 0.2 * (1 - ssim.mean())
