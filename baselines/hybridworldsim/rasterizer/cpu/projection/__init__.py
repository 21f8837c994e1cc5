"""Gaussians to the ellipses that a camera sees."""
