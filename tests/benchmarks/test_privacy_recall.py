"""The benchmark of recall: what is appended to a file, and what is counted from it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.privacy.box_errors import disturb
from benchmarks.privacy.outcomes import Outcome, Thing, Vehicle, append_outcome, read_outcomes
from benchmarks.privacy.recall import Tally, upper_bound
from mirror.privacy.operators import Redaction
from mirror.privacy.regions import region_at

# A car from behind: 10 m ahead of a camera at 1.6 m, its rear 7.8 m away.
CAR = Vehicle(camera_SE3_box=(0.5, 0.5, -0.5, 0.5, 0.0, 0.85, 10.0), size_m=(4.4, 1.8, 1.5), category="car")
SEEN = Thing(box_px=(456.0, 340.0, 504.0, 350.0), seen=1.0)


def outcome(number: int, *, plates: tuple[Thing, ...] = (SEEN,), **more: object) -> Outcome:
    given = {"settings": "s", "width_px": 960, "height_px": 540, "focal_px": 700.0, "faces": (), "regions": (), **more}
    return Outcome(series="street", seed=1, number=number, plates=plates, vehicles=(CAR,), **given)


def test_outcomes_are_appended_and_read_by_their_settings(tmp_path: Path) -> None:
    file = tmp_path / "out" / "day.jsonl"
    assert read_outcomes(file, "s") == []
    append_outcome(file, outcome(0))
    append_outcome(file, outcome(1, settings="other"))
    with file.open("ab") as opened:
        opened.write(b'{"series": "str')
    assert read_outcomes(file, "s") == [outcome(0)]
    append_outcome(file, outcome(2))
    assert read_outcomes(file, "s") == [outcome(0), outcome(2)]
    assert len(file.read_bytes().splitlines()) == 3


def test_a_plate_counts_as_found_if_regions_or_the_fallback_cover_it() -> None:
    tally, hidden = Tally(), Thing(box_px=(10.0, 10.0, 60.0, 20.0), seen=0.5)
    found = region_at((460.0, 341.0, 500.0, 349.0), "plate")
    beside = region_at((100.0, 100.0, 200.0, 140.0), "plate")
    tally.add(outcome(0, plates=(SEEN, hidden), regions=(found,)), Redaction())
    tally.add(outcome(1, regions=(beside,)), Redaction())
    tally.add(outcome(2), Redaction(), plates_only=True)
    assert tally.sizes_px["plate"] == [48.0, 48.0, 48.0]
    assert tally.found["plate", False] == [True, False, False]
    assert tally.found["plate", True] == [True, True, True]
    # The second image: a rectangle of 100 x 40 px, enlarged by 30 %.
    assert tally.outside[False][1] == pytest.approx(130 * 52 / (960 * 540 - 480))
    assert len(tally.outside[True]) == 2 and tally.outside[True][1] > tally.outside[False][1]


def test_boxes_are_disturbed_by_the_error() -> None:
    rng = np.random.default_rng(1)
    places = np.array([disturb(outcome(0), 0.2, rng).vehicles[0].camera_SE3_box[4:] for _ in range(400)])
    # The box's x, y and z are the camera's z, -x and -y.
    assert places.mean(axis=0) == pytest.approx((0.0, 0.85, 10.0), abs=0.05)
    assert places.std(axis=0) == pytest.approx((0.2, 0.2 / 3.0, 0.2), rel=0.15)
    assert disturb(outcome(0), 0.0, rng).vehicles[0].camera_SE3_box == pytest.approx(CAR.camera_SE3_box)


def test_the_bound_is_the_share_at_which_so_few_misses_have_a_chance_of_five_percent() -> None:
    for missed, count in ((0, 149), (3, 400)):
        share = upper_bound(missed, count)
        chances = [1.0]
        for number in range(missed):
            chances.append(chances[-1] * (count - number) / (number + 1) * share / (1.0 - share))
        assert sum(chances) * (1.0 - share) ** count == pytest.approx(0.05, rel=1e-6)
