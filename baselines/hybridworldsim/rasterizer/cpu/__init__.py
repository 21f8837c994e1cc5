"""Rasterization by compiled kernels on the CPU."""

from hybridworldsim.rasterizer.cpu.blend import blend

__all__ = ["blend"]
