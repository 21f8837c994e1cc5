"""Images per second: at most 500 are measured, after three that warm up."""

from __future__ import annotations

import numpy as np
import pytest

from mirror.arrays import UInt8
from mirror.errors import UsageError
from mirror.evaluation.scorers.speed import frames_per_second
from mirror.protocols.views.view import RenderView

VIEWS = [RenderView.model_construct(height_px=4, width_px=6, path=f"{number}.png") for number in range(7)]


def test_a_fast_method_is_measured_over_500_images() -> None:
    asked = []

    def render(view: RenderView) -> UInt8:
        asked.append(view.path)
        return np.zeros((4, 6, 3), np.uint8)

    rate, count = frames_per_second(render, VIEWS)
    assert count == 500 and rate > 100.0
    paths = [view.path for view in VIEWS]
    assert asked == [*paths[:3], *(paths[number % 7] for number in range(500))]


def test_a_render_of_another_size_is_refused_by_its_view() -> None:
    with pytest.raises(UsageError) as caught:
        frames_per_second(lambda view: np.zeros((6, 4, 3), np.uint8), VIEWS)
    assert caught.value.place == "0.png"
