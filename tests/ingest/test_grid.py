"""The grid search for stretches near a ROI, compared with the distance of every fix from every ROI."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.arrays import AnyArray, Bool, Float64, read_only
from mirror.geometry.geodesy import surface_distance_m
from mirror.ingest.fix_status import KEPT, RESTART, Fixes
from mirror.ingest.grid import Circles, build_grid, candidate_stretches
from tests.draws import draws

DROPPED = RESTART + 1
FIXES = st.lists(
    st.tuples(st.integers(-12, 12), st.integers(-12, 12), st.sampled_from([KEPT, KEPT, KEPT, RESTART, DROPPED])),
    max_size=30,
)
ROIS = st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9), st.sampled_from([1.3, 2.7, 6.2])), max_size=4)


def stretches(lon_or_x: Float64, lat_or_y: Float64, status: AnyArray, rois: Float64, geodetic: bool) -> list:
    """Sorted stretches by the grid; ``rois``: (R, 3) centre and radius."""
    circles = Circles(*(np.ascontiguousarray(column) for column in rois.T))
    places = (read_only(np.ascontiguousarray(axis)) for axis in (np.arange(len(status)), lon_or_x, lat_or_y))
    fixes = Fixes(*places, status.astype(np.uint8), geodetic)
    found = candidate_stretches(fixes, circles, build_grid(circles, geodetic))
    return sorted(map(tuple, found.tolist()))


def expected(inside: Bool, status: AnyArray) -> list[tuple[int, int, int]]:
    """Runs of kept fixes inside, each with the kept fix before and after it. ``inside``: (rois, fixes)."""
    kept = np.flatnonzero(status <= RESTART)
    found = []
    for roi, of_roi in enumerate(inside):
        flags = np.concatenate([[False], of_roi[kept], [False]])
        turns = np.flatnonzero(flags[1:] != flags[:-1])
        for begin, end in turns.reshape(-1, 2):
            found.append((roi, int(kept[max(begin - 1, 0)]), int(kept[min(end, len(kept) - 1)])))
    return sorted(found)


@settings(deadline=None, max_examples=draws(150))
@given(FIXES, ROIS.filter(bool))
def test_stretches_in_a_plane(fixes: list[tuple[int, int, int]], rois: list[tuple[int, int, float]]) -> None:
    track, circles = np.array(fixes, np.float64).reshape(-1, 3), np.array(rois, np.float64)
    away = np.hypot(track[:, 0] - circles[:, :1], track[:, 1] - circles[:, 1:2])
    found = stretches(track[:, 0].copy(), track[:, 1].copy(), track[:, 2], circles, False)
    assert found == expected(away < circles[:, 2:], track[:, 2])


@pytest.mark.parametrize(("longitude", "latitude"), [(11.6, 48.1), (179.9995, -60.0), (-179.9995, 0.0), (30.0, 84.9)])
def test_stretches_on_the_globe(longitude: float, latitude: float) -> None:
    """One track crosses the antimeridian. Fixes within 1 cm of a circle are left out."""
    rng = np.random.default_rng(0)
    metre = 1.0 / 111_320.0
    wide = metre / np.cos(np.radians(latitude))
    angle = np.linspace(0, 40, 4000)
    lon = longitude + 4 * angle * np.cos(angle) * wide
    lat = latitude + 4 * angle * np.sin(angle) * metre
    lon = (lon + 180.0) % 360.0 - 180.0
    status = rng.choice([KEPT, KEPT, KEPT, DROPPED], len(lon))
    centres = rng.uniform(-120, 120, (12, 2)) * (wide, metre) + (longitude, latitude)
    rois = np.column_stack([(centres[:, 0] + 180.0) % 360.0 - 180.0, centres[:, 1], rng.uniform(10, 60, 12)])
    away = np.stack([surface_distance_m(lon, lat, roi[0], roi[1]) for roi in rois])
    close = np.abs(away - rois[:, 2:]).min(axis=0) < 0.01
    lon, lat, status, away = lon[~close], lat[~close], status[~close], away[:, ~close]
    assert stretches(lon, lat, status, rois, True) == expected(away < rois[:, 2:], status)
