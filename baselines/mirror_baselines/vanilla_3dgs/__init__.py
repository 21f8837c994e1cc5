"""3D Gaussian splatting as published (Kerbl et al. 2023): all traversals share one set of colours."""

from __future__ import annotations

from mirror_baselines.vanilla_3dgs.settings import BY_HAND, RELEASED, TUNED
from mirror_baselines.vanilla_3dgs.trainer import make, make_empty

__all__ = ["BY_HAND", "RELEASED", "TUNED", "make", "make_empty"]
