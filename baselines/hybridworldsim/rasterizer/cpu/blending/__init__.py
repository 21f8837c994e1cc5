"""Blends ellipses to an image, tile by tile."""
