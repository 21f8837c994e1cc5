"""Rasterization by compiled kernels on the CPU."""

from hybridworldsim.rasterizer.cpu.blending.blend import blend
from hybridworldsim.rasterizer.cpu.projection.project import project
from hybridworldsim.rasterizer.cpu.spherical_harmonics import spherical_harmonics

__all__ = ["blend", "project", "spherical_harmonics"]
