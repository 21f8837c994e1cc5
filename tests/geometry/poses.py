"""Random poses."""

from __future__ import annotations

import numpy as np

from mirror.geometry import Poses


def random_poses(count: int, seed: int = 0, scale_m: float = 10.0) -> Poses:
    generator = np.random.default_rng(seed)
    return Poses(generator.normal(size=(count, 4)), generator.normal(size=(count, 3)) * scale_m)
