"""Renders against photographs: `psnr`, `colour_correction`, `ssim`, and what is made of many scores.

Nothing is imported here: ``from mirror.metrics.images.psnr import psnr``.
"""
