"""Gaussian splatting of one traversal after OmniRe (Chen et al. 2025): a cube of sky, an affine map an image.

OmniRe knows no traversals: all its images share their colours but for an affine map. It is meant for the images of
one traversal, the nearest to the one that is to be rendered; who trains it chooses them, and it runs on several too.
"""

from __future__ import annotations

from mirror_baselines.omnire_style.settings import BY_HAND, RELEASED, TUNED, OmnireStyle
from mirror_baselines.omnire_style.trainer import make

__all__ = ["BY_HAND", "RELEASED", "TUNED", "OmnireStyle", "make"]
