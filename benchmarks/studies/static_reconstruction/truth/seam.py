"""Changes of images across the boundary of two blocks that were trained separately on the same data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from itertools import combinations
from typing import Any, Final

import numpy as np

from benchmarks.street.seam import seam_rows
from benchmarks.studies.static_reconstruction.truth.trained import TrainedModel, evenly_chosen
from hybridworldsim.methods.street import StreetRenderer
from hybridworldsim.model.blocks import Block
from mirror.protocols.views.view import RenderView

_NEAR_M: Final = 5.0
_MOST_VIEWS: Final = 8


def measure_seams(trained: TrainedModel) -> list[dict[str, Any]]:
    """Return rows of `seam_rows` for each two neighbouring blocks; none for a model of one block, or without blocks."""
    street = trained.open()
    if not isinstance(street, StreetRenderer):
        return []
    rows = []
    for pair in combinations(street.blocks, 2):
        (a, _), (b, _) = pair
        across, inside = _views(a, b, trained.plan.views)
        if np.abs(np.subtract(a.index, b.index)).sum() == 1 and across and inside:
            rows += seam_rows(pair, across, inside, street.latents, f"{a.name} to {b.name}")
    return [asdict(row) for row in rows]


def _views(a: Block, b: Block, views: Sequence[RenderView]) -> tuple[list[RenderView], list[RenderView]]:
    """Some views from near the boundary of two blocks, and some beyond the strip that both show, evenly chosen."""
    here, there = np.array(a.origin_m[:2]), np.array(b.origin_m[:2])
    way = (there - here) / np.linalg.norm(there - here)
    away = [abs(float((view.pose.translation[0, :2] - (here + there) / 2.0) @ way)) for view in views]
    near = [view for view, metres in zip(views, away) if metres <= _NEAR_M]
    inside = [view for view, metres in zip(views, away) if metres > a.overlap_m]
    return evenly_chosen(near, _MOST_VIEWS), evenly_chosen(inside, _MOST_VIEWS)
