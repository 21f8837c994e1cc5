"""Measures time and error of rasterizing Gaussians on the CPU, for images and their gradients."""
