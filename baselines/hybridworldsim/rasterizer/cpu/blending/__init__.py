"""Ellipses to a picture, tile by tile."""
