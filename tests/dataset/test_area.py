"""Covered ground against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.dataset.area import covered_area_m2
from mirror.schema.documents import Roi
from tests.draws import draws


def lens_m2(r: float, s: float, d: float) -> float:
    """Area that two circles have in common."""
    if d >= r + s:
        return 0.0
    if d <= abs(r - s):
        return math.pi * min(r, s) ** 2
    alpha = math.acos((d * d + r * r - s * s) / (2 * d * r))
    beta = math.acos((d * d + s * s - r * r) / (2 * d * s))
    return r * r * (alpha - math.sin(2 * alpha) / 2) + s * s * (beta - math.sin(2 * beta) / 2)


def local(name: str, x: float, y: float, radius: float, frame: str = "city") -> Roi:
    return Roi(scene_id=name, frame=frame, x_m=x, y_m=y, radius_m=radius)


def place(name: str, longitude: float, latitude: float, radius: float = 200.0) -> Roi:
    return Roi(scene_id=name, longitude_deg=longitude, latitude_deg=latitude, radius_m=radius)


def test_the_paper_s_ten_scenes() -> None:
    scenes = [place(f"s{number}", 113.0 + 0.1 * number, 23.0 + 3.0 * number) for number in range(10)]
    area_km2 = covered_area_m2(scenes) * 1e-6
    assert area_km2 == pytest.approx(1.2566, abs=1e-4)
    assert 1e3 * area_km2 / 10 == pytest.approx(125.66, abs=0.01)


@settings(max_examples=draws(60), deadline=None)
@given(st.floats(20, 500), st.floats(20, 500), st.floats(0, 1200))
def test_two_circles_in_a_plane(r: float, s: float, d: float) -> None:
    expected = math.pi * (r * r + s * s) - lens_m2(r, s, d)
    found = covered_area_m2([local("a", 1000.0, -50.0, r), local("b", 1000.0 + d, -50.0, s)])
    # A polygon of 720 corners strays from its circle by r / 1e5.
    assert found == pytest.approx(expected, rel=3e-5)


@pytest.mark.parametrize(("longitude", "latitude"), [(0.0, 0.0), (-79.4, 43.6), (179.999, -45.0), (20.0, 78.0)])
def test_two_circles_on_the_globe(longitude: float, latitude: float) -> None:
    import pyproj

    east, north, _ = pyproj.Geod(ellps="WGS84").fwd(longitude, latitude, 70.0, 150.0)
    expected = 2 * math.pi * 200.0**2 - lens_m2(200.0, 200.0, 150.0)
    assert covered_area_m2([place("a", longitude, latitude), place("b", east, north)]) == pytest.approx(
        expected, rel=3e-5
    )


def test_a_chain_against_counted_points() -> None:
    rng = np.random.default_rng(0)
    circles = [(float(x), float(y), float(r)) for x, y, r in np.column_stack(
        [rng.uniform(0, 600, 12), rng.uniform(0, 600, 12), rng.uniform(40, 200, 12)])]  # fmt: skip
    step = 0.5
    grid = np.arange(-250, 850, step) + step / 2
    x, y = np.meshgrid(grid, grid)
    covered = np.zeros(x.shape, bool)
    for cx, cy, r in circles:
        covered |= (x - cx) ** 2 + (y - cy) ** 2 <= r * r
    found = covered_area_m2([local(f"s{k}", *circle) for k, circle in enumerate(circles)])
    assert found == pytest.approx(covered.sum() * step**2, rel=3e-4)


def test_no_scene_one_scene_and_other_frames() -> None:
    assert covered_area_m2([]) == 0.0
    one = local("a", 0.0, 0.0, 10.0)
    assert covered_area_m2([one]) == math.pi * 100.0
    elsewhere = local("b", 0.0, 0.0, 10.0, frame="other")
    assert covered_area_m2([one, elsewhere]) == 2 * math.pi * 100.0
    inside = local("c", 1.0, 0.0, 2.0)
    assert covered_area_m2([one, inside]) == pytest.approx(math.pi * 100.0, rel=1e-9)
