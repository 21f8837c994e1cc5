"""3D Gaussian splatting as published (Kerbl et al. 2023): one set of colours for all traversals."""

from __future__ import annotations

from mirror_baselines.vanilla_3dgs.learner import make
from mirror_baselines.vanilla_3dgs.settings import BY_HAND, RELEASED, TUNED

__all__ = ["BY_HAND", "RELEASED", "TUNED", "make"]
