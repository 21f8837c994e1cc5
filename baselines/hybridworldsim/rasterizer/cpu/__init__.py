"""Rasterization by compiled kernels on the CPU."""

from hybridworldsim.rasterizer.cpu.blending.blend import blend
from hybridworldsim.rasterizer.cpu.harmonics import harmonics
from hybridworldsim.rasterizer.cpu.projection.project import project

__all__ = ["blend", "harmonics", "project"]
