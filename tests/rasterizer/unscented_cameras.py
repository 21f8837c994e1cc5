"""A camera with the lenses of the unscented projection, for its tests."""

from __future__ import annotations

import torch

from hybridworldsim.rasterizer.lenses import LensDistortion

K = torch.tensor([[300.0, 0.0, 315.0], [0.0, 310.0, 245.0], [0.0, 0.0, 1.0]])
WIDTH, HEIGHT = 640, 480
LENSES = {
    "plain": LensDistortion(model="pinhole"),
    "radial": LensDistortion(model="pinhole", radial_coeffs=(-0.28, 0.07, 0.001, 0.01, -0.002, 0.0005)),
    "everything": LensDistortion(
        model="pinhole",
        radial_coeffs=(-0.1, 0.03, -0.001, 0.02, 0.004, -0.0003),
        tangential_coeffs=(0.003, -0.002),
        thin_prism_coeffs=(0.002, -0.0005, -0.001, 0.0004),
    ),
    "equidistant": LensDistortion(model="fisheye"),
    "fisheye": LensDistortion(model="fisheye", radial_coeffs=(-0.02, 0.004, -0.001, 0.0001)),
}
