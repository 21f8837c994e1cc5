"""Rasterization written to be read: plain torch in float64."""

from hybridworldsim.rasterizer.reference.blending import blend
from hybridworldsim.rasterizer.reference.harmonics import harmonics
from hybridworldsim.rasterizer.reference.projection import project

__all__ = ["blend", "harmonics", "project"]
