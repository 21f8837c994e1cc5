"""Tests of facades: the appearance of a footprint equals the mean over many small footprints."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit

from mirror.arrays import Float64, Records
from mirror.synth.light.lighting import LIGHTING
from mirror.synth.model import FACE, Label, Material, flat, polygon
from mirror.synth.render.facades import facade, shopfront, skyline
from mirror.synth.street.houses.windows import PATTERNS, Windows, pattern_table

TABLE = pattern_table()
SAMPLES = 96


@njit
def sampled(one: Records, table: Records, setting: Records, u: float, v: float, fu: float, fv: float) -> Float64:
    """Mean of many small footprints."""
    total = np.zeros(7)
    for i in range(SAMPLES):
        for j in range(SAMPLES):
            x, y = u + ((i + 0.5) / SAMPLES - 0.5) * fu, v + ((j + 0.5) / SAMPLES - 0.5) * fv
            appearance = facade(one, table, 1.0, x, y, fu / SAMPLES, fv / SAMPLES, setting)
            for k in range(7):
                total[k] += appearance[k]
    return total / SAMPLES**2


@njit
def evaluate(one: Records, table: Records, setting: Records, u: float, v: float, fu: float, fv: float) -> Float64:
    return np.array(facade(one, table, 1.0, u, v, fu, fv, setting))


@njit
def shop(one: Records, setting: Records, u: float, v: float, fu: float, fv: float, count: int) -> Float64:
    total = np.zeros(7)
    for i in range(count):
        for j in range(count):
            x, y = u + ((i + 0.5) / count - 0.5) * fu, v + ((j + 0.5) / count - 0.5) * fv
            appearance = shopfront(one, 0.4, 0.3, 0.2, x, y, fu / count, fv / count, setting)
            for k in range(7):
                total[k] += appearance[k]
    return total / count**2


def face(wide: float, high: float, material: Material, layout: int, seed: int = 4) -> Records:
    corners = [(0.0, 0.0, 0.0), (wide, 0.0, 0.0), (wide, 0.0, high), (0.0, 0.0, high)]
    model = polygon(corners, (0.5, 0.4, 0.3), material, Label.BUILDING, layout=layout, seed=seed)
    return model.faces.view(flat(FACE))[0]


def setting(dark: float) -> Records:
    record = np.zeros(1, LIGHTING)
    record["dark"], record["lit_windows"] = dark, 0.45 * dark
    return record.view(flat(LIGHTING))[0]


@pytest.mark.parametrize("windows", list(Windows))
@pytest.mark.parametrize("dark", [0.0, 1.0])
def test_walls_are_means_of_samples(windows: Windows, dark: float) -> None:
    wall, light = face(17.0, 12.4, Material.FACADE, int(windows)), setting(dark)
    rng = np.random.default_rng(int(windows))
    for _ in range(12):
        fu, fv = np.exp(rng.uniform(np.log(0.02), np.log(6.0), 2))
        u = rng.uniform(-0.5, 0.5) * (17.0 - fu)
        v = rng.uniform(-0.5, 0.5) * (12.4 - fv)
        got, want = evaluate(wall, TABLE, light, u, v, fu, fv), sampled(wall, TABLE, light, u, v, fu, fv)
        np.testing.assert_allclose(got, want, atol=2e-5)


def test_a_footprint_beyond_the_face_is_clipped() -> None:
    wall, light = face(9.0, 6.2, Material.FACADE, int(Windows.TALL)), setting(1.0)
    whole = evaluate(wall, TABLE, light, 0.0, 0.0, 9.0, 6.2)
    np.testing.assert_allclose(evaluate(wall, TABLE, light, 0.0, 0.0, 80.0, 80.0), whole, atol=1e-12)
    for u, v in ((4.6, 0.0), (-40.0, 3.2), (0.0, -3.3), (4.5, 3.1)):
        assert np.isfinite(evaluate(wall, TABLE, light, u, v, 0.0, 0.0)).all()


def test_windows_emit_light_only_at_night() -> None:
    wall = face(30.0, 12.4, Material.FACADE, int(Windows.SASH))
    assert not evaluate(wall, TABLE, setting(0.0), 0.0, 0.0, 30.0, 12.4)[3:6].any()
    assert evaluate(wall, TABLE, setting(1.0), 0.0, 0.0, 30.0, 12.4)[3:6].min() > 0.0


def test_share_of_lit_windows_matches_the_setting() -> None:
    light, lit, count = setting(1.0), 0, 0
    pattern = PATTERNS[Windows.MODERN]
    for seed in range(40):
        wall = face(34.0, 31.0, Material.FACADE, int(Windows.MODERN), seed)
        for i in range(10):
            for j in range(10):
                u, v = -17.0 + 3.4 * (i + 0.5) + 0.25, -15.5 + 3.1 * j + pattern.sill_m + 0.3
                lit, count = lit + int(evaluate(wall, TABLE, light, u, v, 0.01, 0.01)[3] > 0.0), count + 1
    assert lit / count == pytest.approx(0.45, abs=4 * np.sqrt(0.45 * 0.55 / count))


def test_neighbours_with_other_seeds_differ() -> None:
    walls = [face(12.0, 9.0, Material.FACADE, int(Windows.SASH), seed) for seed in range(6)]
    looks = {round(float(evaluate(wall, TABLE, setting(1.0), 0.0, 0.0, 12.0, 9.0)[3]), 6) for wall in walls}
    assert len(looks) > 3


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("dark", [0.0, 1.0])
def test_shop_fronts_are_means_of_samples(seed: int, dark: float) -> None:
    front, light = face(5.2, 3.1, Material.SHOPFRONT, 0, seed), setting(dark)
    rng = np.random.default_rng(seed)
    for _ in range(10):
        fu, fv = np.exp(rng.uniform(np.log(0.01), np.log(3.0), 2))
        u, v = rng.uniform(-0.5, 0.5) * (5.2 - fu), rng.uniform(-0.5, 0.5) * (3.1 - fv)
        got, want = shop(front, light, u, v, fu, fv, 1), shop(front, light, u, v, fu, fv, 80)
        np.testing.assert_allclose(got, want, atol=2e-5)


def test_distant_woods_have_no_grain() -> None:
    wood = face(9.0, 14.0, Material.SKYLINE, 0)
    near = [skyline(wood, u, 0.0, 0.1, 0.1)[1] for u in np.linspace(-4, 4, 60)]
    far = [skyline(wood, u, 0.0, 9.0, 9.0)[1] for u in np.linspace(-4, 4, 60)]
    assert np.std(near) > 0.03
    assert np.std(far) < 1e-9
    assert np.mean(far) == pytest.approx(np.mean(near), rel=0.2)
