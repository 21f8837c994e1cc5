"""Renders 3D Gaussians with gradients, through gsplat's interface, on the CPU and on CUDA."""

from hybridworldsim.rasterizer.rasterization import rasterization
from hybridworldsim.rasterizer.rolling_shutter import RollingShutterType

__all__ = ["RollingShutterType", "rasterization"]
