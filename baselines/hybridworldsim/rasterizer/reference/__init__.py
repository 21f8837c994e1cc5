"""Rasterization written to be read: plain torch in float64."""
