"""What ties traversals together in time: one vehicle at the same time, but not one after the other."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from mirror.dataset.layout import Layout
from mirror.dataset.splits.candidates import Candidate, Candidates
from mirror.dataset.splits.leaks import find_ties

SECOND = 1_000_000_000


def test_one_vehicle_may_begin_when_it_ended() -> None:
    assert time_ties([("car", "d0", 0, 5), ("car", "d1", 5, 9)]) == {}
    assert time_ties([("car", "d0", 0, 5), ("car", "d1", 4, 9)]) == {
        ("0", "1"): "are of one vehicle, car, at the same time for 1.0 s"
    }


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(st.sampled_from(["car", "van"]), st.sampled_from(["d0", "d1"]), st.integers(0, 9), st.integers(1, 6)),
        max_size=9,
    )
)
def test_traversals_at_the_same_time_against_every_pair(rows: list[tuple[str, str, int, int]]) -> None:
    spans = [(vehicle, drive, begin, begin + length) for vehicle, drive, begin, length in rows]
    wanted = {}
    for (one, (vehicle, drive, begin, end)), (two, other) in combinations(enumerate(spans), 2):
        both = min(end, other[3]) - max(begin, other[2])
        if vehicle == other[0] and drive != other[1] and both > 0:
            wanted[str(one), str(two)] = f"are of one vehicle, {vehicle}, at the same time for {both:.1f} s"
    assert time_ties(spans) == wanted


def time_ties(rows: list[tuple[str, str, int, int]]) -> dict[tuple[str, ...], str]:
    traversals = {
        str(number): Candidate(str(number), "s", drive, vehicle, begin * SECOND, end * SECOND, "day", "clear", "")
        for number, (vehicle, drive, begin, end) in enumerate(rows)
    }
    found = find_ties(Candidates(Layout(Path("nowhere")), {}, traversals, lambda *_: None), by_scene=False)
    return {tie.members: tie.reason for tie in found if tie.kind == "time"}
