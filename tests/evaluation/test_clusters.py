"""Means of clusters: nested means written out, and the figure that ranks from them again."""

from __future__ import annotations

import math
from typing import Any

import pytest

from mirror.evaluation.clusters import compute_clusters
from mirror.evaluation.figures import compute_figures, compute_overall_figure
from mirror.metrics.catalogue import MEASURES
from mirror.metrics.score import Score
from mirror.protocols.document import load_protocol
from mirror.protocols.views.view import RenderView


def row(group: str, scene: str, traversal: str, value: float | None, metric: str) -> dict[str, Any]:
    return {
        "group": group, "scene_id": scene, "traversal_id": traversal, "frame_index": 0, "camera": "front_wide",
        "light": "day", "weather": "dry", metric: value,
    }  # fmt: skip


def test_traversals_count_alike_in_a_scene_and_scenes_in_the_figure() -> None:
    metric = "matched_structure"
    rows = [
        row("novel", "a", "a1", 0.1, metric), row("novel", "a", "a1", 0.3, metric),
        row("novel", "a", "a2", 0.8, metric),
        row("novel", "b", "b1", 0.6, metric), row("novel", "b", "b1", None, metric),
        row("novel", "c", "c1", None, metric), row("training", "a", "a3", 0.9, metric),
    ]  # fmt: skip
    found = compute_clusters(load_protocol("static-reconstruction"), rows)
    assert [(one.key, one.n) for one in found] == [("a", 3), ("b", 1)]
    assert [one.value for one in found] == pytest.approx([0.5, 0.6])
    assert [one.weight for one in found] == pytest.approx([0.5, 0.5])


def test_a_scenario_counts_once_in_however_many_scenes() -> None:
    rows = [
        row("rollouts", "s", "cut-in", 1.0, "epdms"), row("rollouts", "s", "cut-in", 0.0, "epdms"),
        row("rollouts", "t", "cut-in", 0.2, "epdms"), row("rollouts", "s", "brake", 0.4, "epdms"),
    ]  # fmt: skip
    found = compute_clusters(load_protocol("safety"), rows)
    assert [one.key for one in found] == ["s, brake", "s, cut-in", "t, cut-in"]
    assert [one.value for one in found] == pytest.approx([0.4, 0.5, 0.2])
    assert [one.weight for one in found] == pytest.approx([1 / 2, 1 / 3, 1 / 6])


@pytest.mark.parametrize("name", ["static-reconstruction", "vehicle-translation", "lane-shift", "safety"])
def test_clusters_have_the_mean_that_ranks(name: str) -> None:
    protocol = load_protocol(name)
    assert protocol.ranking is not None
    group, metric = protocol.ranking.column
    rows = [
        row(each, f"s{place % 3}", f"t{place % 5}", math.sin(place + 7 * number), metric)
        for number, each in enumerate(protocol.ranking.groups)
        for place in range(11 + number)
    ]
    views = [RenderView.model_construct(**{key: one[key] for key in one if key != metric}) for one in rows]
    scores = [Score(one[metric]) for one in rows]
    measure = MEASURES[metric]
    overall = compute_overall_figure(protocol, measure, views, scores)
    figures = overall or compute_figures(protocol, measure, group, views, scores)
    found = compute_clusters(protocol, rows)
    assert math.fsum(one.value * one.weight for one in found) == pytest.approx(figures[0].value, abs=1e-12)
    assert math.fsum(one.weight for one in found) == pytest.approx(1.0, abs=1e-12)


def test_figures_of_sets_and_protocols_without_a_key_have_none() -> None:
    rows = [row("novel", "s", "t", 0.5, "psnr")]
    assert compute_clusters(load_protocol("generation"), rows) == ()
    assert compute_clusters(load_protocol("runtime"), rows) == ()
    assert compute_clusters(load_protocol("static-reconstruction"), []) == ()
