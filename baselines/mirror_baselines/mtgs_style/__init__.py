"""Multi-traversal Gaussian splatting after MTGS (Li et al. 2025): each traversal adds its own spherical harmonics.

An untrained traversal is rendered with the appearance of the viewpoint's source, for instance the nearest one.
"""

from __future__ import annotations

from mirror_baselines.mtgs_style.settings import BY_HAND, RELEASED, TUNED, MtgsStyle
from mirror_baselines.mtgs_style.trainer import make, make_empty

__all__ = ["BY_HAND", "RELEASED", "TUNED", "MtgsStyle", "make", "make_empty"]
