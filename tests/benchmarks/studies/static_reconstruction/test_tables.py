"""Intervals compared with scipy's paired test, means as the protocol defines them, and tables of measurements."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.stats import ttest_rel

from benchmarks.studies.static_reconstruction.declaration import load_declaration
from benchmarks.studies.static_reconstruction.groups import groups
from benchmarks.studies.static_reconstruction.jobs import Job
from benchmarks.studies.static_reconstruction.scoring import Scores, average_scores
from benchmarks.studies.static_reconstruction.tables import (
    FIGURES,
    JobResult,
    confidence_interval,
    differences_table,
    mean_tables,
)
from benchmarks.studies.static_reconstruction.truth.tables import all_tables, exact_street_table
from tests.draws import draws

figures = st.floats(-60.0, 60.0)


@settings(max_examples=draws(40), deadline=None)
@given(st.lists(st.tuples(figures, figures), min_size=2, max_size=12), st.sampled_from((0.9, 0.95, 0.99)))
def test_interval_matches_the_paired_t_test(pairs: list[tuple[float, float]], level: float) -> None:
    ours, theirs = np.array(pairs).T
    assume(np.ptp(ours - theirs) > 1e-6)
    known = ttest_rel(ours, theirs).confidence_interval(level)
    np.testing.assert_allclose(confidence_interval(ours - theirs, level), (known.low, known.high), rtol=1e-9, atol=1e-9)


def test_equal_differences_are_certain() -> None:
    assert confidence_interval(np.full(5, 0.25)) == (0.25, 0.25)


def test_one_pair_has_no_interval() -> None:
    assert confidence_interval(np.array([1.0])) == (-np.inf, np.inf)


def test_differences_are_paired_by_scene_and_seed() -> None:
    def result(entry: str, scene: str, seed: int, value: float) -> JobResult:
        return JobResult(Job(entry, scene, seed, 2.0, 240), {"train PSNR": value})

    found = [
        result("ours", "a", 0, 27.0), result("ours", "b", 0, 30.0), result("ours", "c", 0, 99.0),
        result("other", "b", 0, 28.0), result("other", "a", 0, 26.0), result("other", "d", 0, 0.0),
    ]  # fmt: skip
    known = ttest_rel([27.0, 30.0], [26.0, 28.0]).confidence_interval(0.95)
    line = differences_table(found, "ours", ["ours", "other"], ["train PSNR"]).splitlines()[-1]
    assert line == f"| other | +1.500 [{known.low:+.3f}, {known.high:+.3f}] | 2 |"
    # A second seed of one scene gives no information on other scenes.
    found += [result("ours", "a", 1, 28.0), result("other", "a", 1, 26.0)]
    by_scene = ttest_rel([27.5, 30.0], [26.0, 28.0]).confidence_interval(0.95)
    line = differences_table(found, "ours", ["ours", "other"], ["train PSNR"]).splitlines()[-1]
    assert line == f"| other, by scene | +1.750 [{by_scene.low:+.3f}, {by_scene.high:+.3f}] | 2 |"


def test_means_use_the_same_scenes_and_seeds() -> None:
    def result(entry: str, scene: str, seed: int, value: float) -> JobResult:
        return JobResult(Job(entry, scene, seed, 2.0, 240), dict.fromkeys(FIGURES, value))

    found = [result("ours", "a", 0, 10.0), result("ours", "a", 1, 30.0), result("other", "a", 0, 11.0)]
    whole, common = mean_tables(found, ["ours", "other"])
    assert whole.startswith("a: seeds 0, 1\n") and "| ours | 20.00 |" in whole and "other" not in whole
    assert common.startswith("a: seed 0\n") and "| ours | 10.00 |" in common and "| other | 11.00 |" in common


def test_images_are_averaged_within_traversals_first() -> None:
    def scores(traversal: str, value: float, group: str = "novel") -> Scores:
        return Scores("p", group, traversal, value, value + 1.0, value / 100.0)

    found = [
        scores("a", 10.0), scores("a", 20.0), scores("a", float("nan")), scores("b", 30.0), scores("c", 0.0, "training")
    ]  # fmt: skip
    assert average_scores(found, "novel") == pytest.approx({"psnr": 22.5, "psnr_cc": 23.5, "ssim": 0.225})


def measured(scene: str, median: float | None, moved_m: float, fps: float) -> dict[str, Any]:
    scores = {"psnr": 20.0, "psnr_cc": 21.0, "ssim": 0.5}
    return {
        "job": {"entry": "ours", "scene": scene},
        "depth": [{"group": "novel", "from_m": 2.0, "to_m": 5.0, "median": median, "p90": median}],
        "ground": [{"surface": "as drawn", "bias_m": -0.01, "median_m": 0.02, "p90_m": 0.03}],
        "lighting": [{"edit": "day to night", "moved_m": moved_m, "edited": scores, "unedited": scores,
                      "recorded": scores}],
        "seam": [],
        "costs": {"fps": fps, "wall_ms": 1000.0 / fps, "core_ms": 10.0, "mb_per_100_m": 12.0, "threads": 1,
                  "size_px": [480, 270]},
    }  # fmt: skip


def test_tables_are_means_and_show_the_largest_movement() -> None:
    text = all_tables([measured("a", 0.1, 0.0, 10.0), measured("b", 0.2, 0.5, 20.0), measured("c", None, 0.0, 30.0)])
    assert "| ours | novel | 15.0% / 15.0% |" in text
    assert "| ours | as drawn | -0.010 | 0.020 | 0.030 |" in text
    assert "| ours | day to night | 0.5 | 20.00 | 20.00 | 20.00 | 21.00" in text
    assert "| ours | 20 |" in text and "| paper, quoted | 21 at 960 x 540 | - | - | 400 |" in text
    assert "Seams" not in text


def test_the_exact_street_has_rows_of_scenes_and_means() -> None:
    def measured(scene: str, psnr: float) -> dict[str, Any]:
        row = {"group": "novel", "light": "nearest", "poses": "true", "pictures": 5}
        return {"scene": scene, "width_px": 240, "ceiling": [{**row, "psnr": psnr, "psnr_cc": psnr + 1.0, "ssim": 0.5}]}

    group = replace(groups(load_declaration())["comparison"], scenes=("a", "b"))
    records = [measured("a", 20.0), measured("b", 23.0), measured("elsewhere", 0.0)]
    lines = exact_street_table(records, group).splitlines()[2:]
    assert lines == [
        "| novel | nearest | true | a | 20.00 | 21.00 | 0.500 | 5 |",
        "| novel | nearest | true | b | 23.00 | 24.00 | 0.500 | 5 |",
        "| novel | nearest | true | mean | 21.50 | 22.50 | 0.500 | 10 |",
    ]


def test_no_measurement_makes_no_table() -> None:
    assert all_tables([]) == ""
