"""Random dirty drives with regions of interest, on the globe and in a plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st

from mirror.recordings.protocol import Track
from mirror.schema.documents import Roi
from tests.ingest.drives import PLACES, Driver, Place


@dataclass(frozen=True)
class Case:
    track: Track
    rois: list[Roi]
    place: Place


@st.composite
def cases(draw: st.DrawFn, places: list[str]) -> Case:
    place = PLACES[draw(st.sampled_from(places))]
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    driver = Driver(rng)
    driver.fix()
    moves = Driver.moves()
    for name, count in draw(
        st.lists(st.tuples(st.sampled_from(["drive", *moves]), st.integers(1, 30)), min_size=1, max_size=12)
    ):
        moves[name](driver, count)
    t, xy = driver.arrays()
    good = xy[np.all(np.abs(xy) < 1e4, axis=1)]
    rois = []
    for number in range(draw(st.integers(1, 4))):
        x, y = (good[rng.integers(len(good))] if len(good) else np.zeros(2)) + rng.normal(0.0, 30.0, 2)
        radius = draw(st.sampled_from([1.0, 8.0, 40.0, 200.0, 900.0]))
        rois.append(place.roi(float(x), float(y), radius, f"scene_{number}"))
    sigma = np.exp(rng.normal(-1.5, 0.8, len(t))) if draw(st.booleans()) else None
    return Case(place.track(t, xy, sigma), rois, place)
