"""Renders 3D Gaussians with gradients, through gsplat's interface, on the CPU and on CUDA."""

from hybridworldsim.rasterizer.rasterization import rasterization

__all__ = ["rasterization"]
