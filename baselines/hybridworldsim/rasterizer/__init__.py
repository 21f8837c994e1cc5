"""3D Gaussians to pictures, with gradients: gsplat's interface, on the CPU as on CUDA."""

from hybridworldsim.rasterizer.rasterization import rasterization

__all__ = ["rasterization"]
