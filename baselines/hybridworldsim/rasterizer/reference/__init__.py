"""A readable reference of the rasterizer in plain torch and float64."""

from hybridworldsim.rasterizer.reference.blending import blend
from hybridworldsim.rasterizer.reference.projection import project
from hybridworldsim.rasterizer.reference.spherical_harmonics import spherical_harmonics

__all__ = ["blend", "project", "spherical_harmonics"]
