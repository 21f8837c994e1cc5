"""The ROI trigger once more, plainly: float64, exact geodesics, every pose against every ROI.

Written from the rules, not from the kernels: crossings are found by bisection, the closest approach by golden section,
joined stretches are split by recursion. Slow, and meant to be read.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from mirror.arrays import Float64
from mirror.recordings.protocol import Track
from mirror.schema.documents import CleaningOptions, Roi, TriggerOptions
from tests.ingest.reference_cleaning import Fix, cleaned
from tests.ingest.surfaces import Point, Surface, centre_of, surface_of

_GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


@dataclass
class Visit:
    """Within the circle from ``t0`` to ``t1`` (ns)."""

    t0: int
    t1: int
    p0: Point
    p1: Point
    kind0: str
    kind1: str
    closest: float = math.inf


@dataclass
class RefPass:
    """A judged pass, as `mirror.ingest.trigger.Pass` has it."""

    scene_id: str
    entry_ns: int
    exit_ns: int
    entry: Point
    exit: Point
    entry_kind: str
    exit_kind: str
    path_m: float
    inside_path_m: float
    overlap: float
    visits: int
    split: bool
    poses: int
    closest_m: float
    headings: tuple[float, float] | None
    rule: str | None
    parts: list[Visit] = field(default_factory=list)


def closest_share(surface: Surface, p: Point, q: Point, centre: Point) -> float:
    low, high = 0.0, 1.0
    for _ in range(40):
        a, b = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        at_a = surface.distance(surface.between(p, q, a), centre)
        at_b = surface.distance(surface.between(p, q, b), centre)
        if at_a < at_b:
            high = b
        else:
            low = a
    return 0.5 * (low + high)


def crossing_share(
    surface: Surface, p: Point, q: Point, centre: Point, radius: float, s_in: float, s_out: float
) -> float:
    for _ in range(60):
        middle = 0.5 * (s_in + s_out)
        if surface.distance(surface.between(p, q, middle), centre) <= radius:
            s_in = middle
        else:
            s_out = middle
    return 0.5 * (s_in + s_out)


def find_visits(
    surface: Surface,
    fixes: list[Fix],
    centre: Point,
    radius: float,
    max_gap_ns: float,
    steps: Float64 | None = None,
) -> list[Visit]:
    """Maximal intervals with r <= R on the linear motion between fixes."""
    found: list[Visit] = []
    is_open = False
    places = np.array([fix.p for fix in fixes])
    r = surface.distances(places, np.array([centre]))
    steps = surface.distances(places[:-1], places[1:]) if steps is None else steps
    # By the triangle inequality no step comes nearer than this; 0.1 m for the bend of linear motion on the globe.
    nearest_possible = 0.5 * (r[:-1] + r[1:] - steps) - 0.1

    def point(i: int, share: float) -> tuple[int, Point]:
        a, b = fixes[i], fixes[i + 1]
        return a.t + round(share * (b.t - a.t)), surface.between(a.p, b.p, share)

    if r[0] <= radius:
        found.append(Visit(fixes[0].t, 0, fixes[0].p, (0, 0), "recording_edge", "", r[0]))
        is_open = True
    for i in np.flatnonzero(nearest_possible <= radius).tolist():
        a, b = fixes[i], fixes[i + 1]
        if b.unknown or b.t - a.t > max_gap_ns:
            if is_open:
                found[-1].t1, found[-1].p1, found[-1].kind1 = a.t, a.p, "gap"
            is_open = r[i + 1] <= radius
            if is_open:
                found.append(Visit(b.t, 0, b.p, (0, 0), "gap", "", r[i + 1]))
            continue
        share, nearest = 0.0, r[i]
        if not is_open or nearest_possible[i] < found[-1].closest:
            share = closest_share(surface, a.p, b.p, centre)
            nearest = surface.distance(surface.between(a.p, b.p, share), centre)
            share, nearest = min((share, nearest), (0.0, r[i]), (1.0, r[i + 1]), key=lambda one: one[1])
        if not is_open and nearest <= radius:
            t, p = point(i, crossing_share(surface, a.p, b.p, centre, radius, share, 0.0))
            found.append(Visit(t, 0, p, (0, 0), "crossing", "", nearest))
            is_open = True
        if is_open:
            found[-1].closest = min(found[-1].closest, nearest, r[i + 1])
            if r[i + 1] > radius:
                s_in = 0.0 if r[i] <= radius else share
                t, p = point(i, crossing_share(surface, a.p, b.p, centre, radius, s_in, 1.0))
                found[-1].t1, found[-1].p1, found[-1].kind1 = t, p, "crossing"
                is_open = False
    if is_open:
        found[-1].t1, found[-1].p1, found[-1].kind1 = fixes[-1].t, fixes[-1].p, "recording_edge"
    return found


@dataclass
class Counted:
    """A point that counts for the path, and the path so far; ``rest``: only the remaining way to the end."""

    t: int
    p: Point
    path: float
    rest: bool = False


def counted_points(
    surface: Surface, fixes: list[Fix], start: tuple[int, Point], end: tuple[int, Point], options: TriggerOptions
) -> list[Counted]:
    points = [Counted(*start, 0.0)]
    for fix in fixes:
        last = points[-1]
        if not last.t < fix.t <= end[0]:
            continue
        step = surface.distance(last.p, fix.p)
        least = options.min_step_m
        if fix.sigma is not None and math.isfinite(fix.sigma):
            least = max(least, options.step_sigmas * fix.sigma)
        if step >= least:
            points.append(Counted(fix.t, fix.p, last.path + step))
    last = points[-1]
    if end[0] > last.t:
        points.append(Counted(*end, last.path + surface.distance(last.p, end[1]), rest=True))
    return points


def cut_standstills(surface: Surface, fixes: list[Fix], visit: Visit, options: TriggerOptions) -> list[Visit]:
    """The visit without what stands still for longer than the limit."""
    if options.trim_standstill_s is None:
        return [visit]
    limit = round(options.trim_standstill_s * 1e9)
    points = counted_points(surface, fixes, (visit.t0, visit.p0), (visit.t1, visit.p1), options)
    stands = []
    for here, following in itertools.pairwise(points):
        if following.t - here.t <= limit:
            continue
        until = following.t
        if not following.rest or visit.kind1 == "crossing":
            until = max([here.t] + [fix.t for fix in fixes if here.t < fix.t < following.t])
        if until - here.t > limit:
            stands.append((here.t, until, here.p))
    parts = []
    t0, p0, kind0 = visit.t0, visit.p0, visit.kind0
    for begin, end, p in stands:
        if begin > t0:
            parts.append(Visit(t0, begin, p0, p, kind0, "standstill", visit.closest))
        t0, p0, kind0 = end, p, "standstill"
    if visit.t1 > t0 or not stands:
        parts.append(Visit(t0, visit.t1, p0, visit.p1, kind0, visit.kind1, visit.closest))
    if not parts:
        parts.append(Visit(visit.t0, visit.t0, visit.p0, visit.p0, visit.kind0, "standstill", visit.closest))
    return parts


def path_at(points: list[Counted], t: int) -> float:
    for a, b in itertools.pairwise(points):
        if a.t <= t <= b.t:
            return a.path + (b.path - a.path) * ((t - a.t) / (b.t - a.t))
    return points[-1].path if t > points[-1].t else 0.0


def judge(
    surface: Surface,
    fixes: list[Fix],
    scene_id: str,
    parts: list[Visit],
    options: TriggerOptions,
    *,
    clip: bool = False,
    split: bool = False,
) -> list[RefPass]:
    """Verdict on joined visits; split at the longest excursion where the overlap is too small."""
    if clip:
        start, end, kinds = (fixes[0].t, fixes[0].p), (fixes[-1].t, fixes[-1].p), ("recording_edge",) * 2
    else:
        start, end = (parts[0].t0, parts[0].p0), (parts[-1].t1, parts[-1].p1)
        kinds = parts[0].kind0, parts[-1].kind1
    points = counted_points(surface, fixes, start, end, options)
    path = points[-1].path
    inside = sum(path_at(points, one.t1) - path_at(points, one.t0) for one in parts)
    duration = end[0] - start[0]
    if path > 0.0:
        overlap = min(inside / path, 1.0)
    else:
        overlap = sum(one.t1 - one.t0 for one in parts) / duration if duration else 1.0
    if not clip and len(parts) > 1 and overlap <= options.min_overlap:
        away = [
            (path_at(points, after.t0) - path_at(points, before.t1), after.t0 - before.t1)
            for before, after in itertools.pairwise(parts)
        ]
        far = max(metres for metres, _ in away) - 1e-3
        long = max(ns for metres, ns in away if metres >= far) - 1_000_000
        tied = [i for i, (metres, ns) in enumerate(away) if metres >= far and ns >= long]
        cut = 1 + min(tied, key=lambda i: (abs(i - (len(away) - 1) / 2), i))
        return [
            one
            for half in (parts[:cut], parts[cut:])
            for one in judge(surface, fixes, scene_id, half, options, split=True)
        ]
    rule = None
    if duration < round(options.min_duration_s * 1e9):
        rule = "min_duration"
    elif path < options.min_path_m:
        rule = "min_path"
    elif overlap <= options.min_overlap:
        rule = "min_overlap"
    moving = [(a.p, b.p) for a, b in itertools.pairwise(points) if b.path > a.path]
    return [
        RefPass(
            scene_id=scene_id,
            entry_ns=start[0],
            exit_ns=end[0],
            entry=start[1],
            exit=end[1],
            entry_kind=kinds[0],
            exit_kind=kinds[1],
            path_m=path,
            inside_path_m=inside,
            overlap=overlap,
            visits=len(parts),
            split=split,
            poses=sum(start[0] <= fix.t <= end[0] for fix in fixes),
            closest_m=min(one.closest for one in parts),
            headings=(surface.course(*moving[0]), surface.course(*moving[-1])) if moving else None,
            rule=rule,
            parts=parts,
        )
    ]


def passes(
    track: Track,
    rois: list[Roi],
    options: TriggerOptions | None = None,
    cleaning: CleaningOptions | None = None,
    *,
    clip: bool = False,
) -> list[RefPass]:
    """Every pass of a track through every ROI."""
    options, cleaning = options or TriggerOptions(), cleaning or CleaningOptions()
    surface, _ = surface_of(track)
    fixes = cleaned(track, cleaning, options.min_step_m)
    places = np.array([fix.p for fix in fixes])
    steps = surface.distances(places[:-1], places[1:])
    found: list[RefPass] = []
    for roi in rois:
        max_gap_ns = math.inf if clip else round(options.max_gap_s * 1e9)
        visits = find_visits(surface, fixes, centre_of(roi), roi.radius_m, max_gap_ns, steps)
        if not clip:
            visits = [part for one in visits for part in cut_standstills(surface, fixes, one, options)]
        joined: list[list[Visit]] = []
        for one in visits:
            together = joined and (
                clip
                or (
                    joined[-1][-1].kind1 == one.kind0 == "crossing"
                    and one.t0 - joined[-1][-1].t1 <= round(options.join_gap_s * 1e9)
                )
            )
            if together:
                joined[-1].append(one)
            else:
                joined.append([one])
        for parts in joined:
            found += judge(surface, fixes, roi.scene_id, parts, options, clip=clip)
    return found


def radial_speed(surface: Surface, fixes: list[Fix], t: int, centre: Point) -> float:
    """Absolute rate of change of the distance from the centre at a time, in m/s."""
    stamps = np.array([fix.t for fix in fixes])
    i = int(np.clip(np.searchsorted(stamps, t) - 1, 0, len(fixes) - 2))
    a, b = fixes[i], fixes[i + 1]
    share, step = (t - a.t) / (b.t - a.t), 1e-4
    r = [surface.distance(surface.between(a.p, b.p, share + d), centre) for d in (-step, step)]
    return abs(r[1] - r[0]) / (2 * step * (b.t - a.t) * 1e-9)
