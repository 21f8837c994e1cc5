"""Gaussian splatting of one traversal after OmniRe (Chen et al. 2025): a sky cube, and a colour map for each image.

OmniRe does not model traversals: all its images share their colours up to an affine map. It is meant for the images of
one traversal, the nearest to the one to be rendered. The user selects these images; it also accepts several traversals.
"""

from __future__ import annotations

from mirror_baselines.omnire_style.settings import BY_HAND, RELEASED, TUNED, OmnireStyle
from mirror_baselines.omnire_style.trainer import make, make_empty

__all__ = ["BY_HAND", "RELEASED", "TUNED", "OmnireStyle", "make", "make_empty"]
