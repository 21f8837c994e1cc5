"""Pictures of what was blended, without gradients: which Gaussian, how many, how deep; and which way surfaces face."""

from hybridworldsim.rasterizer.buffers.normals import facing_axes, normals
from hybridworldsim.rasterizer.buffers.traced import Buffers, trace

__all__ = ["Buffers", "facing_axes", "normals", "trace"]
