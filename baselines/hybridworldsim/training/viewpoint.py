"""The import path of `hybridworldsim.trainable.viewpoint` in methods that were written for version 0.1."""

from hybridworldsim.trainable.viewpoint import NEAREST_M, Source, Viewpoint, require_pinhole, to_viewpoint

__all__ = ["NEAREST_M", "Source", "Viewpoint", "require_pinhole", "to_viewpoint"]
