"""The compiled trigger against the plain one: random dirty drives, random ROIs, on the globe and in a plane."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from mirror.ingest.clean import clean
from mirror.ingest.trigger import Pass, RoiTrigger
from mirror.schema.documents import CleaningOptions, TriggerOptions
from tests.draws import draws
from tests.ingest import reference
from tests.ingest.cases import Case, cases
from tests.ingest.drives import PLACES
from tests.ingest.reference_cleaning import cleaned, statuses
from tests.ingest.surfaces import centre_of, surface_of

_STATUSES = ("kept", "restart", "invalid", "duplicate_time", "repeated", "outlier")


def both(case: Case, options: TriggerOptions, clip: bool) -> tuple[list[Pass], list[reference.RefPass]]:
    cleaning = CleaningOptions()
    track, _ = clean(case.track, cleaning, min_step_m=options.min_step_m)
    ours = RoiTrigger(case.rois, options, cleaning).passes(track, frame=case.place.frame, is_clip=clip)
    return ours, reference.passes(case.track, case.rois, options, cleaning, clip=clip)


def require_equal(case: Case, options: TriggerOptions, *, clip: bool = False) -> None:
    ours, theirs = both(case, options, clip)
    assert [one.scene_id for one in ours] == [one.scene_id for one in theirs]
    surface, _ = surface_of(case.track)
    fixes = cleaned(case.track, CleaningOptions(), options.min_step_m)
    by_id = {roi.scene_id: roi for roi in case.rois}
    for one, ref in zip(ours, theirs):
        roi = by_id[one.scene_id]
        centre = centre_of(roi)
        assert (one.entry_kind, one.exit_kind) == (ref.entry_kind, ref.exit_kind)
        for t, t_ref, kind, p in (
            (one.entry_ns, ref.entry_ns, one.entry_kind, one.entry),
            (one.exit_ns, ref.exit_ns, one.exit_kind, one.exit),
        ):
            if kind == "crossing":
                assert abs(surface.distance(p, centre) - roi.radius_m) < 1e-3
                if abs(t - t_ref) > 1_000_000:
                    assert reference.radial_speed(surface, fixes, t_ref, centre) < 1.0
            else:
                assert t == t_ref
            if case.place.frame is None:
                assert abs(p[0]) <= 180.0
        assert (one.visits, one.split, one.poses) == (ref.visits, ref.split, ref.poses)
        assert one.path_m == pytest.approx(ref.path_m, rel=2e-5, abs=2e-3)
        assert one.inside_path_m == pytest.approx(ref.inside_path_m, rel=2e-5, abs=4e-3)
        assert one.overlap == pytest.approx(ref.overlap, abs=1e-3 + 1e-2 / max(ref.path_m, 0.1))
        assert one.closest_m == pytest.approx(ref.closest_m, abs=1e-3)
        if ref.headings is not None and ref.path_m > 0.1:
            for ours_deg, ref_deg in zip((one.heading_in_deg, one.heading_out_deg), ref.headings):
                assert ours_deg is not None
                assert abs((ours_deg - ref_deg + 180.0) % 360.0 - 180.0) < 0.01
        measured = {
            "min_duration": (ref.exit_ns - ref.entry_ns) / 1e9 - options.min_duration_s,
            "min_path": ref.path_m - options.min_path_m,
            "min_overlap": ref.overlap - options.min_overlap,
        }
        if min(map(abs, measured.values())) > 1e-3:
            assert one.rule == ref.rule


LENIENT = TriggerOptions(min_duration_s=2.0, min_path_m=5.0)
SHORT = TriggerOptions(trim_standstill_s=8.0, max_gap_s=5.0, join_gap_s=6.0, min_overlap=0.6)
LONG_GAP = TriggerOptions(max_gap_s=30.0, trim_standstill_s=None)
quick = settings(max_examples=draws(60), deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True)


@quick
@given(case=cases(["city", "south", "equator", "antimeridian"]), options=st.sampled_from([LENIENT, SHORT, LONG_GAP]))
def test_trigger_on_the_globe(case: Case, options: TriggerOptions) -> None:
    require_equal(case, options)


@quick
@given(case=cases(["plane", "far plane"]), options=st.sampled_from([LENIENT, SHORT, LONG_GAP]))
def test_trigger_in_a_plane(case: Case, options: TriggerOptions) -> None:
    require_equal(case, options)


@settings(quick, max_examples=draws(20))
@given(case=cases(["city", "plane", "antimeridian"]))
def test_clips(case: Case) -> None:
    require_equal(case, TriggerOptions(min_overlap=0.5), clip=True)


@settings(quick, max_examples=draws(100))
@given(case=cases(list(PLACES)))
def test_fates(case: Case) -> None:
    options = CleaningOptions()
    expected, order = statuses(case.track, options)
    track, report = clean(case.track, options)
    assert [_STATUSES[status] for status in track.status] == expected
    assert track.recorded(np.arange(len(order))).tolist() == order
    assert report.poses == len(order)
    for name, count in (
        ("kept", expected.count("kept") + expected.count("restart")),
        ("invalid", expected.count("invalid")),
        ("duplicate_time", expected.count("duplicate_time")),
        ("repeated", expected.count("repeated")),
        ("outliers", expected.count("outlier")),
        ("restarts", expected.count("restart")),
    ):
        assert getattr(report, name) == count
    kept = track.kept()
    assert np.all(np.diff(track.timestamp_ns[kept]) > 0)
    assert not math.isnan(track.lon_or_x[kept].sum())
