"""Which pictures a vehicle took while it hardly moved: copies of one view teach nothing, and witness nothing."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from typing import Final

import numpy as np

from mirror.arrays import Float64

STATIONARY_M: Final = 0.25


def select_moving(taken: Iterable[tuple[Hashable, Float64]], stationary_m: float = STATIONARY_M) -> list[int]:
    """Positions of pictures whose camera has moved since the last of its own that was kept.

    Args:
        taken: of each picture which camera of which traversal took it, and (3,) where, metres; those of a camera in
            order of time.
        stationary_m: a camera that is nearer than this to where the last kept picture was taken stands. 0: all move.

    Returns:
        In the given order; the first of each camera is always among them.
    """
    last: dict[Hashable, Float64] = {}
    kept = []
    for position, (camera, here) in enumerate(taken):
        if camera in last and np.linalg.norm(here - last[camera]) < stationary_m:
            continue
        last[camera] = here
        kept.append(position)
    return kept
