"""Tests of markings: their share of a pixel against many small samples."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.errors import UsageError
from mirror.synth.model import FACE, flat
from mirror.synth.render.carriageway import carriageway, mark_share, stripe_share
from mirror.synth.roads.markings import (
    MOST_MARKS,
    Mark,
    dashed_line,
    hatched_area,
    pack_layouts,
    parking_bays,
    solid_line,
    stop_line,
    yield_line,
    zebra_marks,
)
from tests.draws import draws

MARKS = {
    "solid": solid_line(0.3, 0.06),
    "dashes": dashed_line(0.0, 0.06, 9.0, 3.0),
    "bays": parking_bays(3.6, 5.8)[1],
    "zebra": zebra_marks((-1.0, 2.0), 4.0),
    "stop": stop_line((0.2, 0.7), (-3.4, -0.2)),
    "yield": yield_line((0.2, 0.7), (-3.4, -0.2)),
}


def sampled(mark, u, v, fu, fv, count=400):
    """The painted share of a footprint, estimated from point samples."""
    shares = (np.arange(count) + 0.5) / count - 0.5
    x, y = u + fu * shares[:, None], v + fv * shares[None, :]
    inside = (x >= mark.u_m[0]) & (x < mark.u_m[1]) & (y >= mark.v_m[0]) & (y < mark.v_m[1])
    for at, (period, duty, phase) in ((x - mark.slant * y, mark.u_stripes), (y, mark.v_stripes)):
        if period > 0.0:
            inside = inside & (np.mod(at - phase, period) < duty * period)
    return inside.mean()


@pytest.mark.parametrize("name", MARKS)
@settings(max_examples=draws(25), deadline=None)
@given(st.floats(-6.0, 6.0), st.floats(-6.0, 6.0), st.floats(0.01, 8.0), st.floats(0.01, 2.0))
def test_share_of_a_mark_is_exact(name, u, v, fu, fv):
    mark = MARKS[name]
    row = pack_layouts([[mark]])[0]
    assert mark_share(row[0], u, v, fu, fv) == pytest.approx(sampled(mark, u, v, fu, fv), abs=0.006)


@settings(max_examples=draws(25), deadline=None)
@given(st.floats(-2.0, 2.0), st.floats(-0.8, 0.8), st.floats(0.01, 0.3), st.floats(0.01, 0.3))
def test_share_of_slanted_stripes(u, v, fu, fv):
    mark = hatched_area((-5.0, 5.0), (-1.0, 1.0), 0.8)
    row = pack_layouts([[mark]])[0]
    assert mark_share(row[0], u, v, fu, fv) == pytest.approx(sampled(mark, u, v, fu, fv), abs=0.13)


def test_mean_over_pixels_is_independent_of_the_footprint():
    row = pack_layouts([[MARKS["dashes"]]])[0]
    for fu in (0.05, 0.5, 2.0, 7.0):
        at = np.linspace(0.0, 90.0, 2000, endpoint=False)
        mean = np.mean([mark_share(row[0], u, 0.0, fu, 0.1) for u in at])
        assert mean == pytest.approx(1.0 / 3.0, abs=0.004)


def test_extreme_footprints_are_valid():
    assert stripe_share(0.0, 1e9, -1.0, 1.0, 0.0, 1.0, 0.0) == pytest.approx(2e-9)
    assert stripe_share(5.0, 1e-9, 0.0, 10.0, 0.0, 1.0, 0.0) == pytest.approx(1.0)
    assert stripe_share(-5.0, 1.0, 0.0, 10.0, 2.0, 0.5, 0.0) == 0.0
    assert stripe_share(1e6 + 0.25, 0.1, -1e7, 1e7, 1.0, 0.5, 0.0) == pytest.approx(1.0, abs=1e-6)


def face():
    one = np.zeros(1, FACE)
    one["colour"], one["layout"], one["seed"] = (0.1, 0.1, 0.1), 1, 4
    return one.view(flat(FACE))[0]


def test_paint_is_bright_and_distant_markings_are_their_mean():
    table = pack_layouts([(), (solid_line(0.0, 1.0),)])
    rng = np.random.default_rng(0)
    on = np.array([carriageway(face(), table, 1.0, u, 0.0, 0.05, 0.05) for u in rng.uniform(0, 500, 400)])
    off = np.array([carriageway(face(), table, 1.0, u, 3.0, 0.05, 0.05) for u in rng.uniform(0, 500, 400)])
    assert 0.45 < on[:, 0].mean() < 0.62 and 0.08 < off[:, 0].mean() < 0.11
    assert on[:, 0].std() > 0.01
    far = np.array(carriageway(face(), table, 1.0, 250.0, 0.0, 60.0, 8.0))
    wanted = 0.25 * on[:, 0].mean() + 0.75 * off[:, 0].mean()
    assert far[0] == pytest.approx(wanted, abs=0.025)
    assert (far[3:] == 0.0).all()


def test_a_footprint_is_the_mean_of_its_parts():
    table = pack_layouts(
        [(), (dashed_line(0.0, 0.06, 6.0, 3.0), *parking_bays(1.6, 3.8), zebra_marks((2.0, 5.0), 4.0))]
    )
    rng = np.random.default_rng(3)
    for _ in range(12):
        u, v, fu, fv = rng.uniform(0, 40), rng.uniform(-3, 3), rng.uniform(0.3, 3.0), rng.uniform(0.1, 0.8)
        shares = (np.arange(40) + 0.5) / 40 - 0.5
        small = [
            carriageway(face(), table, 1.0, u + a * fu, v + b * fv, fu / 40, fv / 40)[0] for a in shares for b in shares
        ]
        assert carriageway(face(), table, 1.0, u, v, fu, fv)[0] == pytest.approx(np.mean(small), abs=0.03)


def test_too_many_marks_are_refused():
    with pytest.raises(UsageError, match="marks"):
        pack_layouts([[Mark((0.0, 1.0), (0.0, 1.0))] * (MOST_MARKS + 1)])
