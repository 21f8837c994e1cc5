"""Rasterization by compiled kernels on the CPU."""
