"""Time of a render of a trained model, MLPs included, and bytes of the model for a length of road."""

from __future__ import annotations

import time
from typing import Any, Final

import torch

from benchmarks.street.benchmark import HEIGHT, PAPER_MS, WIDTH, time_views
from benchmarks.studies.static_reconstruction.truth.trained import TrainedModel, evenly_chosen
from mirror.protocols.views.view import RenderView

PAPER_FPS: Final = 1000.0 / PAPER_MS
PAPER_SIZE: Final = "960 x 540"
PAPER_MB: Final = 400.0
"""Of 100 m, quoted; its machine is not stated."""
_MOST_VIEWS: Final = 12


def measure_costs(trained: TrainedModel) -> dict[str, Any]:
    """Return the times of 8-bit renders of held-out views, and the size of the model."""
    chosen = [_wide(view) for view in evenly_chosen(trained.views("novel"), _MOST_VIEWS)]
    renderer = trained.open()
    _, wall_ms = time_views(renderer, chosen)
    _, core_ms = time_views(renderer, chosen, time.process_time)
    costs = trained.costs
    return {
        "wall_ms": wall_ms,
        "core_ms": core_ms,
        "fps": 1000.0 / wall_ms,
        "threads": torch.get_num_threads(),
        "size_px": [WIDTH, HEIGHT],
        "model_bytes": costs.model_bytes,
        "driven_m": costs.driven_m,
        "mb_per_100_m": costs.model_bytes / costs.driven_m * 100.0 / 1e6,
    }


def _wide(view: RenderView) -> RenderView:
    """A view from the same pose with the lens of the timed size, 80 degrees wide."""
    lens = {
        "width_px": WIDTH, "height_px": HEIGHT, "fx_px": 0.6 * WIDTH, "fy_px": 0.6 * WIDTH, "cx_px": WIDTH / 2.0,
        "cy_px": HEIGHT / 2.0,
    }  # fmt: skip
    return view.model_copy(update=lens)
