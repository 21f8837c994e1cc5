"""Lenses with distortion."""

from hybridworldsim.rasterizer.lenses import LensDistortion

FISHEYE = LensDistortion(model="fisheye", radial_coeffs=(0.05, -0.01, 0.002, -0.0005))
BROWN = LensDistortion(
    model="pinhole", radial_coeffs=(-0.1, 0.02, -0.001, 0.03, 0.004, 0.0005), tangential_coeffs=(0.002, -0.001),
    thin_prism_coeffs=(0.001, -0.0005, 0.0008, 0.0003),
)  # fmt: skip
