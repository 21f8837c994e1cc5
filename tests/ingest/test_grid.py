"""Which stretches of a track come near a ROI, against every fix and every ROI."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.geometry.geodesy import surface_distance_m
from mirror.ingest.clean import KEPT, RESTART
from mirror.ingest.grid import build_grid, near

DROPPED = RESTART + 1
FIXES = st.lists(
    st.tuples(st.integers(-12, 12), st.integers(-12, 12), st.sampled_from([KEPT, KEPT, KEPT, RESTART, DROPPED])),
    max_size=30,
)
ROIS = st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9), st.sampled_from([1.3, 2.7, 6.2])), max_size=4)


def stretches(first: np.ndarray, second: np.ndarray, fate: np.ndarray, rois: np.ndarray, geodetic: bool) -> list:
    grid = build_grid(rois[:, 0], rois[:, 1], rois[:, 2], geodetic)
    found = near(
        first, second, fate.astype(np.uint8), geodetic, rois[:, 0], rois[:, 1], rois[:, 2],
        grid.origin, grid.inverse, grid.columns, grid.keys, grid.begin, grid.end, grid.members,
    )  # fmt: skip
    return sorted(map(tuple, found.tolist()))


def expected(inside: np.ndarray, fate: np.ndarray) -> list[tuple[int, int, int]]:
    """Runs of kept fixes that are inside, one kept fix longer at both ends. ``inside``: (rois, fixes)."""
    kept = np.flatnonzero(fate <= RESTART)
    found = []
    for roi, of_roi in enumerate(inside):
        flags = np.concatenate([[False], of_roi[kept], [False]])
        turns = np.flatnonzero(flags[1:] != flags[:-1])
        for begin, end in turns.reshape(-1, 2):
            found.append((roi, int(kept[max(begin - 1, 0)]), int(kept[min(end, len(kept) - 1)])))
    return sorted(found)


@settings(deadline=None, max_examples=150)
@given(FIXES, ROIS.filter(bool))
def test_in_a_plane(fixes: list[tuple[int, int, int]], rois: list[tuple[int, int, float]]) -> None:
    track, circles = np.array(fixes, np.float64).reshape(-1, 3), np.array(rois, np.float64)
    away = np.hypot(track[:, 0] - circles[:, :1], track[:, 1] - circles[:, 1:2])
    found = stretches(track[:, 0].copy(), track[:, 1].copy(), track[:, 2], circles, False)
    assert found == expected(away < circles[:, 2:], track[:, 2])


@pytest.mark.parametrize(("longitude", "latitude"), [(11.6, 48.1), (179.9995, -60.0), (-179.9995, 0.0), (30.0, 84.9)])
def test_on_the_globe(longitude: float, latitude: float) -> None:
    """The track crosses the antimeridian. Only the fixes that are clearly inside or outside are compared."""
    rng = np.random.default_rng(0)
    metre = 1.0 / 111_320.0
    wide = metre / np.cos(np.radians(latitude))
    angle = np.linspace(0, 40, 4000)
    lon = longitude + 4 * angle * np.cos(angle) * wide
    lat = latitude + 4 * angle * np.sin(angle) * metre
    lon = (lon + 180.0) % 360.0 - 180.0
    fate = rng.choice([KEPT, KEPT, KEPT, DROPPED], len(lon))
    centres = rng.uniform(-120, 120, (12, 2)) * (wide, metre) + (longitude, latitude)
    rois = np.column_stack([(centres[:, 0] + 180.0) % 360.0 - 180.0, centres[:, 1], rng.uniform(10, 60, 12)])
    away = np.stack([surface_distance_m(lon, lat, roi[0], roi[1]) for roi in rois])
    close = np.abs(away - rois[:, 2:]).min(axis=0) < 0.01
    lon, lat, fate, away = lon[~close], lat[~close], fate[~close], away[:, ~close]
    assert stretches(lon, lat, fate, rois, True) == expected(away < rois[:, 2:], fate)
