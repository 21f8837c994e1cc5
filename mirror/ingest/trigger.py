"""The ROI trigger: finds the parts of a drive that are traversals, with the figures that decide.

The rules are the paper's (section 3: at least 10 s, at least 20 m, more than 90 % overlap with the ROI).
docs/trigger.md states them exactly: distances and lengths are on the ellipsoid, motion between cleaned fixes is linear,
a place with ``r <= R`` is inside, entry and exit are interpolated on the circle.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mirror.arrays import Int64, Records, read_only
from mirror.ingest.clean import CleanTrack
from mirror.ingest.grid import Circles, Grid, build_grid, candidate_stretches
from mirror.ingest.path import FIGURES, Figures, StepRule, cut_standstills, measure_passes
from mirror.ingest.visits import CROSSING, RECORDING_EDGE, VISIT, Visit, find_visits
from mirror.schema.documents import CleaningOptions, Roi, TriggerOptions

Rule = Literal["min_duration", "min_path", "min_overlap"]
EdgeKind = Literal["crossing", "recording_edge", "gap", "standstill"]
_KINDS: tuple[EdgeKind, ...] = ("crossing", "recording_edge", "gap", "standstill")
_POSE_MARGIN_S = 1.0


@dataclass(frozen=True)
class Pass:
    """One accepted or refused pass of a drive through a ROI.

    Attributes:
        scene_id: the ROI.
        entry_ns: time of the entry, interpolated.
        exit_ns: time of the exit, interpolated.
        entry_kind: how the pass begins: on the circle, at an end of the recording, after a gap or after a standstill.
        exit_kind: how it ends.
        entry: place of the entry: longitude and latitude in degrees, or x and y in metres.
        exit: place of the exit.
        duration_s: exit - entry.
        path_m: driven length.
        inside_path_m: the part of it within the ROI.
        overlap: inside_path_m / path_m; for a vehicle that did not move, the share of time inside.
        visits: number of visits that were joined to this pass.
        split: whether the pass is a part of a longer one that was split at its longest excursion.
        poses: cleaned fixes between entry and exit.
        closest_m: smallest distance from the centre.
        heading_in_deg: direction of travel at the entry, clockwise from north; None: the vehicle did not move.
        heading_out_deg: direction of travel at the exit.
        rule: the rule that refused the pass; None: accepted.
        measured: the figure that this rule compares.
        threshold: the value that it compares with.
    """

    scene_id: str
    entry_ns: int
    exit_ns: int
    entry_kind: EdgeKind
    exit_kind: EdgeKind
    entry: tuple[float, float]
    exit: tuple[float, float]
    duration_s: float
    path_m: float
    inside_path_m: float
    overlap: float
    visits: int
    split: bool
    poses: int
    closest_m: float
    heading_in_deg: float | None
    heading_out_deg: float | None
    rule: Rule | None
    measured: float | None
    threshold: float | None

    @property
    def mean_speed_mps(self) -> float:
        """path_m / duration_s; 0 for a pass without duration."""
        return self.path_m / self.duration_s if self.duration_s > 0.0 else 0.0

    @property
    def accepted(self) -> bool:
        """Return whether the pass is a traversal."""
        return self.rule is None


@dataclass(frozen=True)
class _Area:
    """The ROIs of one coordinate frame as arrays, with a grid to search them.

    Attributes:
        rois: the ROIs.
        circles: their centres and radii.
        search: the same circles with a margin.
        grid: of the circles with the margin.
    """

    rois: tuple[Roi, ...]
    circles: Circles
    search: Circles
    grid: Grid

    @classmethod
    def from_rois(cls, rois: Sequence[Roi], margin_m: float) -> _Area:
        geodetic = rois[0].frame is None
        axes = ("longitude_deg", "latitude_deg") if geodetic else ("x_m", "y_m")
        lon_or_x, lat_or_y = (np.array([getattr(roi, axis) for roi in rois], np.float64) for axis in axes)
        radius_m = np.array([roi.radius_m for roi in rois], np.float64)
        search = Circles(lon_or_x, lat_or_y, radius_m + margin_m)
        return cls(tuple(rois), Circles(lon_or_x, lat_or_y, radius_m), search, build_grid(search, geodetic))


class RoiTrigger:
    """The trigger for a set of ROIs, usable for any number of tracks and threads.

    Args:
        rois: regions of interest. A track is compared with the ROIs of its own frame.
        options: the thresholds.
        cleaning: the thresholds of cleaning; its speed limit bounds the distance between two fixes.
    """

    def __init__(self, rois: Sequence[Roi], options: TriggerOptions, cleaning: CleaningOptions) -> None:
        self.options = options
        self._reach_s = max(options.max_gap_s, options.join_gap_s, _POSE_MARGIN_S)
        margin_m = cleaning.max_speed_mps * self._reach_s + cleaning.noise_m
        self._areas = {
            frame: _Area.from_rois([roi for roi in rois if roi.frame == frame], margin_m)
            for frame in {roi.frame for roi in rois}
        }

    def passes(self, track: CleanTrack, *, frame: str | None = None, is_clip: bool = False) -> list[Pass]:
        """Find all passes of a track through the ROIs of its frame, accepted and refused, sorted by ROI and time.

        Args:
            track: cleaned.
            frame: name of the track's local metric frame; None: WGS 84.
            is_clip: whether the source arrives as clips. The whole track is then the pass through each ROI it visits.
        """
        area = self._areas.get(frame)
        if area is None:
            return []
        visits = self._find_visits(track, area, is_clip)
        if not len(visits):
            return []
        same_roi = visits["roi"][1:] == visits["roi"][:-1]
        joined = same_roi & (
            is_clip
            | (visits["exit_kind"][:-1] == CROSSING)
            & (visits["entry_kind"][1:] == CROSSING)
            & (visits["entry_ns"][1:] - visits["exit_ns"][:-1] <= round(self.options.join_gap_s * 1e9))
        )
        begin = np.flatnonzero(np.concatenate([[True], ~joined]))
        end = np.append(begin[1:], len(visits))
        return self._judge_passes(track, area.rois, visits, begin, end, is_clip=is_clip)

    def _find_visits(self, track: CleanTrack, area: _Area, is_clip: bool) -> Records:
        """Visits of a track, without long standstills, sorted by ROI and time."""
        fixes = track.fixes()
        stretches = self._clip_stretches(track, len(area.rois)) if is_clip else None
        if stretches is None:
            stretches = candidate_stretches(fixes, area.search, area.grid)
        max_gap_ns = np.iinfo(np.int64).max if is_clip else round(self.options.max_gap_s * 1e9)
        visits = _fill_growing(
            max(64, 2 * len(stretches)), lambda out: find_visits(fixes, area.circles, stretches, max_gap_ns, out)
        )
        if self.options.trim_standstill_s is not None and not is_clip:
            limit_ns, rule, uncut = round(self.options.trim_standstill_s * 1e9), self._step_rule(track), visits
            visits = _fill_growing(2 * len(uncut) + 64, lambda out: cut_standstills(fixes, rule, uncut, limit_ns, out))
        return visits[np.lexsort((visits["entry_ns"], visits["roi"]))]

    def _clip_stretches(self, track: CleanTrack, rois: int) -> Int64 | None:
        """The whole clip as a stretch for every ROI, if its gaps are so long that a step may pass over a ROI.

        A gap does not end the visits of a clip. None: `candidate_stretches` finds all that is needed.
        """
        kept = track.kept()
        if len(kept) < 2 or np.diff(track.timestamp_ns[kept]).max() <= self._reach_s * 1e9:
            return None
        return np.array([[roi, kept[0], kept[-1]] for roi in range(rois)], np.int64)

    def _step_rule(self, track: CleanTrack) -> StepRule:
        """Return the rule by which fixes of a track count for its path."""
        sigma_m = np.empty(0) if track.sigma_m is None else track.sigma_m
        return StepRule(read_only(sigma_m), self.options.step_sigmas, self.options.min_step_m)

    def _judge_passes(
        self,
        track: CleanTrack,
        rois: Sequence[Roi],
        visits: Records,
        begin: Int64,
        end: Int64,
        *,
        is_clip: bool,
    ) -> list[Pass]:
        """Measure and judge the passes that join the visits ``begin:end``; split those with too little overlap."""
        judged: dict[int, Pass] = {}
        is_part = False
        while len(begin):
            if is_clip:
                candidates = np.repeat(_clip_as_visit(track), len(begin))
            else:
                candidates = visits[begin].copy()
                for name in ("exit_ns", "exit_lon_or_x", "exit_lat_or_y", "exit_kind", "stop"):
                    candidates[name] = visits[name][end - 1]
            measured = np.zeros(len(begin), FIGURES)
            measure_passes(track.fixes(), self._step_rule(track), candidates, begin, end, visits, measured)
            parts: list[tuple[int, int]] = []
            rows = zip(
                candidates.tolist(), measured.tolist(), visits["roi"][begin].tolist(), begin.tolist(), end.tolist()
            )
            for candidate, values, roi, low, high in rows:
                extent, figures = Visit._make(candidate), Figures._make(values)
                drive_pass = self._judge_pass(rois[roi].scene_id, extent, figures, visits=high - low, is_part=is_part)
                if not is_clip and high - low > 1 and drive_pass.overlap <= self.options.min_overlap:
                    parts += [(low, figures.cut), (figures.cut, high)]
                else:
                    judged[low] = drive_pass
            begin, end = np.array(parts, np.int64).reshape(-1, 2).T
            is_part = True
        return [judged[low] for low in sorted(judged)]

    def _judge_pass(self, scene_id: str, extent: Visit, figures: Figures, *, visits: int, is_part: bool) -> Pass:
        """Compare one pass with the thresholds; the first rule that fails refuses it."""
        options = self.options
        duration_s = (extent.exit_ns - extent.entry_ns) / 1e9
        if figures.path_m > 0.0:
            overlap = min(figures.inside_path_m / figures.path_m, 1.0)
        else:
            duration_ns = extent.exit_ns - extent.entry_ns
            overlap = figures.inside_ns / duration_ns if duration_ns > 0 else 1.0
        rule: Rule | None = None
        measured = threshold = None
        if duration_s < options.min_duration_s:
            rule, measured, threshold = "min_duration", duration_s, options.min_duration_s
        elif figures.path_m < options.min_path_m:
            rule, measured, threshold = "min_path", figures.path_m, options.min_path_m
        elif overlap <= options.min_overlap:
            rule, measured, threshold = "min_overlap", overlap, options.min_overlap
        return Pass(
            scene_id=scene_id,
            entry_ns=extent.entry_ns,
            exit_ns=extent.exit_ns,
            entry_kind=_KINDS[extent.entry_kind],
            exit_kind=_KINDS[extent.exit_kind],
            entry=(extent.entry_lon_or_x, extent.entry_lat_or_y),
            exit=(extent.exit_lon_or_x, extent.exit_lat_or_y),
            duration_s=duration_s,
            path_m=figures.path_m,
            inside_path_m=figures.inside_path_m,
            overlap=overlap,
            visits=visits,
            split=is_part,
            poses=figures.poses,
            closest_m=figures.closest_m,
            heading_in_deg=None if math.isnan(figures.heading_in_deg) else figures.heading_in_deg,
            heading_out_deg=None if math.isnan(figures.heading_out_deg) else figures.heading_out_deg,
            rule=rule,
            measured=measured,
            threshold=threshold,
        )


def _fill_growing(size: int, fill: Callable[[Records], int]) -> Records:
    """Call ``fill`` with an array of dtype `VISIT` that is large enough; it returns the number of visits it has."""
    out = np.zeros(size, VISIT)
    while (count := fill(out)) > len(out):
        out = np.zeros(count, VISIT)
    return out[:count]


def _clip_as_visit(track: CleanTrack) -> Records:
    """(1,) The whole track as one visit."""
    kept = track.kept()
    clip = np.zeros(1, VISIT)
    for side, position in (("entry", kept[0]), ("exit", kept[-1])):
        clip[f"{side}_ns"] = track.timestamp_ns[position]
        clip[f"{side}_lon_or_x"], clip[f"{side}_lat_or_y"] = track.lon_or_x[position], track.lat_or_y[position]
        clip[f"{side}_kind"] = RECORDING_EDGE
    clip["start"], clip["stop"] = kept[0], kept[-1] + 1
    return clip
