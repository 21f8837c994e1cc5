"""Tests of middle lines against the definition of their curvature."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.synth.roads.line import Bend, build_line
from tests.draws import draws

BENDS = (Bend(-40.0, 90.0, 0.5), Bend(70.0, 80.0, -0.6))
LINE = build_line((3.0, -2.0), 0.4, -150.0, 160.0, BENDS)


def test_line_begins_at_its_place_and_turns_by_its_bends():
    np.testing.assert_allclose(LINE.at(0.0), (3.0, -2.0), atol=1e-12)
    assert float(LINE.heading(0.0)) == pytest.approx(0.4, abs=1e-12)
    turned = float(LINE.heading(LINE.last_m) - LINE.heading(LINE.first_m))
    assert turned == pytest.approx(0.5 - 0.6, abs=1e-9)


def test_least_radius_matches_the_raised_cosine():
    curvature = np.gradient(LINE.headings, LINE.stations)
    assert np.abs(curvature).max() == pytest.approx(2 * 0.6 / 80.0, rel=1e-3)
    # The curvature is continuous: its derivative is bounded.
    assert np.abs(np.diff(curvature)).max() < 2e-4


def test_stations_are_arc_length_and_headings_are_tangents():
    steps = np.diff(LINE.points, axis=0)
    length = np.hypot(*steps.T).sum()
    assert length == pytest.approx(LINE.last_m - LINE.first_m, abs=1e-3)
    heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    np.testing.assert_allclose(heading, LINE.heading(LINE.stations[:-1] + 0.05), atol=1e-5)


def test_positions_match_quadrature():
    fine = np.linspace(0.0, 100.0, 200_001)
    heading = LINE.heading(fine)
    for axis, part in enumerate((np.cos, np.sin)):
        values = part(heading)
        total = ((values[1:] + values[:-1]) * 0.5 * np.diff(fine)).sum()
        assert float(LINE.at(100.0)[axis] - LINE.at(0.0)[axis]) == pytest.approx(total, abs=1e-5)


@settings(max_examples=draws(60), deadline=None)
@given(st.floats(-148.0, 158.0), st.floats(-25.0, 25.0))
def test_locate_inverts_at(station, offset):
    found = LINE.locate(LINE.at(np.array([station]), np.array([offset])))
    np.testing.assert_allclose([found[0][0], found[1][0]], [station, offset], atol=1e-4)


def test_line_continues_straight_beyond_its_ends():
    station, offset = LINE.locate(LINE.at(np.array([-170.0, 200.0]), np.array([3.0, -7.0])))
    np.testing.assert_allclose(station, (-170.0, 200.0), atol=1e-9)
    np.testing.assert_allclose(offset, (3.0, -7.0), atol=1e-9)


def test_lines_far_from_the_origin_are_accurate():
    far = build_line((5e6, -4e6), 1.0, 0.0, 30.0)
    np.testing.assert_allclose(far.at(30.0), (5e6 + 30 * math.cos(1.0), -4e6 + 30 * math.sin(1.0)), atol=1e-6)
    station, offset = far.locate(far.at(np.array([12.0]), np.array([2.0])))
    assert station[0] == pytest.approx(12.0, abs=1e-5) and offset[0] == pytest.approx(2.0, abs=1e-5)


def test_until_keeps_the_stretch_around_station_0():
    kept = LINE.until(80.0)
    assert np.hypot(*kept.points.T).max() <= 80.0
    assert kept.first_m < 0.0 < kept.last_m
    assert np.hypot(*LINE.at(kept.last_m + 0.2)) > 80.0
