"""Intervals against scipy's paired test, means as the protocol has them, tables of what was measured."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.stats import ttest_rel

from benchmarks.studies.static_reconstruction.job import Job
from benchmarks.studies.static_reconstruction.scoring import Scores, averaged
from benchmarks.studies.static_reconstruction.tables import FIGURES, Outcome, differences, interval
from benchmarks.studies.static_reconstruction.tables import tables as tables_of_outcomes
from benchmarks.studies.static_reconstruction.truth.tables import ceiling_table, tables

figures = st.floats(-60.0, 60.0)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(figures, figures), min_size=2, max_size=12), st.sampled_from((0.9, 0.95, 0.99)))
def test_interval_is_that_of_the_paired_test(pairs: list[tuple[float, float]], level: float) -> None:
    ours, theirs = np.array(pairs).T
    assume(np.ptp(ours - theirs) > 1e-6)
    known = ttest_rel(ours, theirs).confidence_interval(level)
    np.testing.assert_allclose(interval(ours - theirs, level), (known.low, known.high), rtol=1e-9, atol=1e-9)


def test_equal_differences_are_certain() -> None:
    assert interval(np.full(5, 0.25)) == (0.25, 0.25)


def test_one_pair_bounds_nothing() -> None:
    assert interval(np.array([1.0])) == (-np.inf, np.inf)


def test_differences_are_paired_by_scene_and_seed() -> None:
    def outcome(entry: str, scene: str, seed: int, value: float) -> Outcome:
        return Outcome(Job(entry, scene, seed, 2.0, 240), {"train PSNR": value})

    found = [
        outcome("ours", "a", 0, 27.0), outcome("ours", "b", 0, 30.0), outcome("ours", "c", 0, 99.0),
        outcome("other", "b", 0, 28.0), outcome("other", "a", 0, 26.0), outcome("other", "d", 0, 0.0),
    ]  # fmt: skip
    known = ttest_rel([27.0, 30.0], [26.0, 28.0]).confidence_interval(0.95)
    line = differences(found, "ours", ["ours", "other"], ["train PSNR"]).splitlines()[-1]
    assert line == f"| other | +1.500 [{known.low:+.3f}, {known.high:+.3f}] | 2 |"
    # Two seeds of one scene tell no more of other scenes than one does.
    found += [outcome("ours", "a", 1, 28.0), outcome("other", "a", 1, 26.0)]
    by_scene = ttest_rel([27.5, 30.0], [26.0, 28.0]).confidence_interval(0.95)
    line = differences(found, "ours", ["ours", "other"], ["train PSNR"]).splitlines()[-1]
    assert line == f"| other, by scene | +1.750 [{by_scene.low:+.3f}, {by_scene.high:+.3f}] | 2 |"


def test_means_are_of_the_same_scenes_and_seeds() -> None:
    def outcome(entry: str, scene: str, seed: int, value: float) -> Outcome:
        return Outcome(Job(entry, scene, seed, 2.0, 240), dict.fromkeys(FIGURES, value))

    found = [outcome("ours", "a", 0, 10.0), outcome("ours", "a", 1, 30.0), outcome("other", "a", 0, 11.0)]
    whole, common = tables_of_outcomes(found, ["ours", "other"])
    assert whole.startswith("a: seeds 0, 1\n") and "| ours | 20.00 |" in whole and "other" not in whole
    assert common.startswith("a: seed 0\n") and "| ours | 10.00 |" in common and "| other | 11.00 |" in common


def test_pictures_are_averaged_in_traversals_first() -> None:
    def scores(traversal: str, value: float, group: str = "novel") -> Scores:
        return Scores("p", group, traversal, value, value + 1.0, value / 100.0)

    found = [
        scores("a", 10.0), scores("a", 20.0), scores("a", float("nan")), scores("b", 30.0), scores("c", 0.0, "training")
    ]  # fmt: skip
    assert averaged(found, "novel") == pytest.approx({"psnr": 22.5, "psnr_cc": 23.5, "ssim": 0.225})


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


def test_tables_are_means_and_say_the_most_that_moves() -> None:
    text = tables([measured("a", 0.1, 0.0, 10.0), measured("b", 0.2, 0.5, 20.0), measured("c", None, 0.0, 30.0)])
    assert "| ours | novel | 15.0% / 15.0% |" in text
    assert "| ours | as drawn | -0.010 | 0.020 | 0.030 |" in text
    assert "| ours | day to night | 0.5 | 20.00 | 20.00 | 20.00 | 21.00" in text
    assert "| ours | 20 |" in text and "| paper, quoted | 21 at 960 x 540 | - | - | 400 |" in text
    assert "Seams" not in text


def test_the_exact_street_is_told_by_scene_and_on_average() -> None:
    def measured(scene: str, psnr: float) -> dict[str, Any]:
        row = {"group": "novel", "light": "nearest", "poses": "true", "pictures": 5}
        return {"scene": scene, "ceiling": [{**row, "psnr": psnr, "psnr_cc": psnr + 1.0, "ssim": 0.5}]}

    lines = ceiling_table([measured("a", 20.0), measured("b", 23.0)]).splitlines()[2:]
    assert lines == [
        "| novel | nearest | true | a | 20.00 | 21.00 | 0.500 | 5 |",
        "| novel | nearest | true | b | 23.00 | 24.00 | 0.500 | 5 |",
        "| novel | nearest | true | mean | 21.50 | 22.50 | 0.500 | 10 |",
    ]


def test_nothing_measured_makes_no_table() -> None:
    assert tables([]) == ""
