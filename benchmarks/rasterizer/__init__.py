"""Rasterizing Gaussians on the CPU: time against error, for images and their gradients."""
