"""Nested means against loops over dictionaries, and intervals that resample blocks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mirror.evaluation.figures import (
    MIN_BLOCKS,
    compute_figures,
    linearise_mean,
    mean_weights,
    weighted_interval,
)
from mirror.metrics.catalogue import MEASURES
from mirror.metrics.score import Score
from mirror.protocols.views.view import RenderView
from tests.evaluation.submissions import small

MEASURE = MEASURES["psnr"]


def view(scene: str, traversal: str, frame: int, camera: str = "front_wide") -> RenderView:
    return RenderView.model_construct(
        path=f"{traversal}/{camera}/{frame}",
        group="novel",
        scene_id=scene,
        traversal_id=traversal,
        frame_index=frame,
        camera=camera,
        light="day",
        weather="clear",
    )


PLACES = st.lists(st.tuples(st.sampled_from("AB"), st.sampled_from("xyz")), min_size=1, max_size=20)


@given(PLACES, st.sampled_from([(), ("traversal",), ("scene",), ("traversal", "scene")]))
def test_nested_means(places: list[tuple[str, str]], averaging: tuple[str, ...]) -> None:
    views = [view(scene, f"{scene}.{name}", number) for number, (scene, name) in enumerate(places)]
    values = np.random.default_rng(len(places)).normal(25.0, 3.0, len(places))
    weights = mean_weights(views, averaging)
    assert math.fsum(weights) == pytest.approx(1.0)

    def mean(parts: dict[str, list[float]]) -> list[float]:
        return [float(np.mean(part)) for part in parts.values()]

    grouped: dict[str, dict[str, list[float]]] = {}
    for item, value in zip(views, values):
        scene = item.scene_id if "scene" in averaging else ""
        traversal = item.traversal_id if "traversal" in averaging else ""
        grouped.setdefault(scene, {}).setdefault(traversal, []).append(value)
    wanted = np.mean([np.mean(mean(parts)) for parts in grouped.values()])
    assert weights @ values == pytest.approx(wanted)
    assert linearise_mean(values, weights).mean() == pytest.approx(wanted)


def test_figures_count_values_that_are_not_finite() -> None:
    views = [view("A", "A.x", number) for number in range(4)]
    scores = [Score(20.0), Score(math.inf), Score(math.nan, "the mask selects no pixel"), Score(30.0)]
    group = compute_figures(small(), MEASURE, "novel", views, scores)[0]
    assert (group.value, group.n, group.n_inf, group.n_missing) == (25.0, 4, 1, 1)
    none = compute_figures(small(), MEASURE, "novel", views[:2], [Score(math.inf), Score(math.nan, "empty")])[0]
    assert none.value is None
    assert none.reason is not None
    assert "infinite" in none.reason


def test_each_scene_traversal_and_camera_has_a_figure() -> None:
    views = [view("A", f"A.{name}", frame, camera) for name in "xy" for frame in (0, 5) for camera in ("a", "b")]
    figures = compute_figures(small(), MEASURE, "novel", views, [Score(float(place)) for place in range(8)])
    levels = [(figure.level, figure.key) for figure in figures]
    assert levels[0] == ("group", "")
    assert {key for level, key in levels if level == "traversal"} == {"A.x", "A.y"}
    assert {key for level, key in levels if level == "camera"} == {"a", "b"}
    assert {key for level, key in levels if level == "condition"} == {"day, clear"}


def test_intervals_resample_whole_blocks() -> None:
    protocol = small(block=2)
    rng = np.random.default_rng(0)
    views = [view("A", "A.x", frame) for frame in range(40)]
    values = [Score(value) for value in np.repeat(rng.normal(25.0, 2.0, 20), 2)]
    figure = compute_figures(protocol, MEASURE, "novel", views, values)[0]
    assert figure.low is not None
    assert figure.high is not None
    assert figure.value is not None
    assert figure.low < figure.value < figure.high
    # Twenty independent pairs have the interval of twenty values, not of forty.
    half = 1.96 * np.std([float(value) for value in values[::2]], ddof=1) / math.sqrt(20)
    assert (figure.high - figure.low) / 2 == pytest.approx(half, rel=0.35)
    few = compute_figures(protocol, MEASURE, "novel", views[: 2 * MIN_BLOCKS - 2], values[: 2 * MIN_BLOCKS - 2])[0]
    assert few.low is None
    assert few.interval_reason is not None


def test_the_least_number_of_blocks_has_an_interval() -> None:
    protocol = small(block=2)
    views = [view("A", "A.x", frame) for frame in range(2 * MIN_BLOCKS)]
    values = np.random.default_rng(1).normal(25.0, 2.0, len(views))
    weights = np.full(len(views), 1 / len(views))
    mean, interval = weighted_interval(protocol, views, values, weights)
    assert mean == pytest.approx(values.mean())
    assert interval.low < mean < interval.high
    _, few = weighted_interval(protocol, views[:-2], values[:-2], weights[:-2])
    assert math.isnan(few.low)
