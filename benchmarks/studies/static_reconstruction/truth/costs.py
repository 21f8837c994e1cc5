"""How fast a trained model draws, decode included, and how many bytes a stretch of road takes."""

from __future__ import annotations

import time
from typing import Any, Final

import torch

from benchmarks.street.benchmark import HEIGHT, PAPER_MS, WIDTH, timed
from benchmarks.studies.static_reconstruction.truth.trained import Trained, spread
from mirror.protocols.views.view import View

PAPER_FPS: Final = 1000.0 / PAPER_MS
PAPER_SIZE: Final = "960 x 540"
PAPER_MB: Final = 400.0
"""Of 100 m, quoted; its machine is not stated."""
_MOST_VIEWS: Final = 12


def costs_of(trained: Trained) -> dict[str, Any]:
    """Times of whole pictures of views of a held-out traversal, as 8-bit pixels, and the size of the model."""
    chosen = [_wide(view) for view in spread(trained.views("novel"), _MOST_VIEWS)]
    renderer = trained.open()
    _, wall_ms = timed(renderer, chosen)
    _, core_ms = timed(renderer, chosen, time.process_time)
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


def _wide(view: View) -> View:
    """A view's place through a lens of the size that is timed, which sees 80 degrees across."""
    lens = {
        "width_px": WIDTH, "height_px": HEIGHT, "fx_px": 0.6 * WIDTH, "fy_px": 0.6 * WIDTH, "cx_px": WIDTH / 2.0,
        "cy_px": HEIGHT / 2.0,
    }  # fmt: skip
    return view.model_copy(update=lens)
