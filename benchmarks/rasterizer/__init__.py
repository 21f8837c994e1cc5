"""Rasterizing Gaussians on the CPU: time against error, for pictures and their gradients."""
