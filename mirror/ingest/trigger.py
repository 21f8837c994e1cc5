"""The ROI trigger: which parts of a drive are traversals, and by which figures.

The rules are the paper's (section 3: at least 10 s, at least 20 m, more than 90 % overlap with the ROI), made exact as
docs/trigger.md states: distances and lengths on the ellipsoid, linear motion between cleaned fixes, ``r <= R`` inside,
entry and exit interpolated on the circle.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mirror.arrays import Float64, Int64, Records, UInt8
from mirror.ingest.clean import CleanTrack
from mirror.ingest.grid import Grid, build_grid, near
from mirror.ingest.path import FIGURES, figures, without_standstills
from mirror.ingest.visits import CROSSING, RECORDING_EDGE, VISIT, visits
from mirror.schema.documents import CleaningOptions, Roi, TriggerOptions

Rule = Literal["min_duration", "min_path", "min_overlap"]
EdgeKind = Literal["crossing", "recording_edge", "gap", "standstill"]
_KINDS: tuple[EdgeKind, ...] = ("crossing", "recording_edge", "gap", "standstill")
_POSE_MARGIN_S = 1.0


@dataclass(frozen=True)
class Pass:
    """One pass of a drive through a ROI, judged.

    Attributes:
        scene_id: the ROI.
        entry_ns: entry, interpolated.
        exit_ns: exit, interpolated.
        entry_kind: what ended it at the entry side.
        exit_kind: what ended it at the exit side.
        entry: coordinates of the entry (longitude, latitude in degrees; or x, y in metres).
        exit: coordinates of the exit.
        duration_s: exit - entry.
        path_m: driven length.
        inside_path_m: the part of it within the ROI.
        overlap: inside_path_m / path_m; where nothing was driven, the share of time inside.
        visits: how many visits it joins.
        split: whether it is one part of a stretch that was split at its longest excursion.
        poses: cleaned fixes between entry and exit.
        closest_m: smallest distance from the centre.
        heading_in_deg: direction of travel at the entry, clockwise from north; None: did not move.
        heading_out_deg: direction of travel at the exit.
        rule: the rule that refused it; None: accepted.
        measured: what the rule looked at.
        threshold: what it asked for.
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
        """path_m / duration_s."""
        return self.path_m / self.duration_s if self.duration_s > 0.0 else 0.0

    @property
    def accepted(self) -> bool:
        """Whether the pass is a traversal."""
        return self.rule is None


@dataclass(frozen=True)
class _Area:
    """The ROIs of one frame as arrays, with the grid that finds them."""

    rois: tuple[Roi, ...]
    first: Float64
    second: Float64
    radius_m: Float64
    reach_m: Float64
    grid: Grid

    @classmethod
    def of(cls, rois: Sequence[Roi], margin_m: float) -> _Area:
        axes = ("longitude_deg", "latitude_deg") if rois[0].frame is None else ("x_m", "y_m")
        first, second = (np.array([getattr(roi, axis) for roi in rois], np.float64) for axis in axes)
        radius = np.array([roi.radius_m for roi in rois], np.float64)
        grid = build_grid(first, second, radius + margin_m, rois[0].frame is None)
        return cls(tuple(rois), first, second, radius, radius + margin_m, grid)


class Trigger:
    """The trigger for one set of ROIs; made once, used for any number of tracks, thread-safe.

    Args:
        rois: regions of interest; those in another frame than a track's are passed over.
        options: the thresholds.
        cleaning: how tracks were cleaned; its speed bounds how far a fix can be from the next.
    """

    def __init__(self, rois: Sequence[Roi], options: TriggerOptions, cleaning: CleaningOptions) -> None:
        self.options = options
        self._reach_s = max(options.max_gap_s, options.join_gap_s, _POSE_MARGIN_S)
        margin_m = cleaning.max_speed_mps * self._reach_s + cleaning.noise_m
        self._areas = {
            frame: _Area.of([roi for roi in rois if roi.frame == frame], margin_m)
            for frame in {roi.frame for roi in rois}
        }

    def passes(self, track: CleanTrack, *, frame: str | None = None, is_clip: bool = False) -> list[Pass]:
        """Every pass of the track through the ROIs of its frame, accepted or refused, by ROI and time.

        Args:
            track: cleaned.
            frame: name of the track's local metric frame; None: WGS 84.
            is_clip: the source arrives as clips: the whole track is the candidate, for every ROI that it visits.
        """
        area = self._areas.get(frame)
        if area is None:
            return []
        found = self._visits(track, area, is_clip)
        if not len(found):
            return []
        same_roi = found["roi"][1:] == found["roi"][:-1]
        joined = same_roi & (
            is_clip
            | (found["exit_kind"][:-1] == CROSSING)
            & (found["entry_kind"][1:] == CROSSING)
            & (found["entry_ns"][1:] - found["exit_ns"][:-1] <= round(self.options.join_gap_s * 1e9))
        )
        begin = np.flatnonzero(np.concatenate([[True], ~joined]))
        end = np.append(begin[1:], len(found))
        return self._judge(track, area.rois, found, begin, end, clip=is_clip)

    def _visits(self, track: CleanTrack, area: _Area, is_clip: bool) -> Records:
        circles = (area.first, area.second)
        stretches = self._long_stretches(track, len(area.rois)) if is_clip else None
        if stretches is None:
            stretches = near(
                track.first,
                track.second,
                track.fate,
                track.geodetic,
                *circles,
                area.reach_m,
                area.grid.origin,
                area.grid.inverse,
                area.grid.columns,
                area.grid.keys,
                area.grid.begin,
                area.grid.end,
                area.grid.members,
            )
        max_gap_ns = np.iinfo(np.int64).max if is_clip else round(self.options.max_gap_s * 1e9)
        room = np.zeros(max(64, 2 * len(stretches)), VISIT)
        while True:
            count = visits(
                track.timestamp_ns,
                track.first,
                track.second,
                track.fate,
                track.geodetic,
                *circles,
                area.radius_m,
                stretches,
                max_gap_ns,
                room,
            )
            if count <= len(room):
                break
            room = np.zeros(count, VISIT)
        found = room[:count]
        if self.options.trim_standstill_s is not None and not is_clip:
            found = self._without_standstills(track, found, round(self.options.trim_standstill_s * 1e9))
        return found[np.lexsort((found["entry_ns"], found["roi"]))]

    def _long_stretches(self, track: CleanTrack, rois: int) -> Int64 | None:
        """All of a clip for every ROI, if it has gaps in which it may leap over one: a gap does not end its visits."""
        kept = track.kept()
        if len(kept) < 2 or np.diff(track.timestamp_ns[kept]).max() <= self._reach_s * 1e9:
            return None
        return np.array([[roi, kept[0], kept[-1]] for roi in range(rois)], np.int64)

    def _without_standstills(self, track: CleanTrack, found: Records, limit_ns: int) -> Records:
        room = np.zeros(2 * len(found) + 64, VISIT)
        while True:
            count = without_standstills(*self._steps(track), found, limit_ns, room)
            if count <= len(room):
                return room[:count]
            room = np.zeros(count, VISIT)

    def _steps(self, track: CleanTrack) -> tuple[Int64, Float64, Float64, UInt8, Float64, float, float, bool]:
        """The arguments by which the path kernels see a track."""
        return (
            track.timestamp_ns,
            track.first,
            track.second,
            track.fate,
            np.empty(0) if track.sigma_m is None else track.sigma_m,
            self.options.step_sigmas,
            self.options.min_step_m,
            track.geodetic,
        )

    def _judge(
        self,
        track: CleanTrack,
        rois: Sequence[Roi],
        found: Records,
        begin: Int64,
        end: Int64,
        *,
        clip: bool,
    ) -> list[Pass]:
        """Measure and judge the passes that join the visits ``begin:end``; split those with too little overlap."""
        judged: dict[int, Pass] = {}
        split = False
        while len(begin):
            if clip:
                candidates = np.repeat(_whole(track), len(begin))
            else:
                candidates = found[begin].copy()
                for name in ("exit_ns", "exit_first", "exit_second", "exit_kind", "stop"):
                    candidates[name] = found[name][end - 1]
            measured = np.zeros(len(begin), FIGURES)
            figures(*self._steps(track), candidates, begin, end, found, measured)
            halves: list[tuple[int, int]] = []
            rows = zip(
                candidates.tolist(), measured.tolist(), found["roi"][begin].tolist(), begin.tolist(), end.tolist()
            )
            for candidate, figure, roi, low, high in rows:
                one = self._verdict(rois[roi].scene_id, candidate, figure, visits=high - low, split=split)
                if not clip and high - low > 1 and one.overlap <= self.options.min_overlap:
                    cut = figure[-1]
                    halves += [(low, cut), (cut, high)]
                else:
                    judged[low] = one
            begin, end = np.array(halves, np.int64).reshape(-1, 2).T
            split = True
        return [judged[low] for low in sorted(judged)]

    def _verdict(
        self, scene_id: str, candidate: Sequence[Any], figure: Sequence[Any], *, visits: int, split: bool
    ) -> Pass:
        options = self.options
        (_, entry_ns, exit_ns, entry_1, entry_2, exit_1, exit_2, _, _, entry_kind, exit_kind, _) = candidate
        path_m, inside_m, heading_in, heading_out, closest_m, poses, inside_ns, _ = figure
        duration_s = (exit_ns - entry_ns) / 1e9
        if path_m > 0.0:
            overlap = min(inside_m / path_m, 1.0)
        else:
            overlap = inside_ns / (exit_ns - entry_ns) if exit_ns > entry_ns else 1.0
        rule: Rule | None = None
        measured = threshold = None
        if duration_s < options.min_duration_s:
            rule, measured, threshold = "min_duration", duration_s, options.min_duration_s
        elif path_m < options.min_path_m:
            rule, measured, threshold = "min_path", path_m, options.min_path_m
        elif overlap <= options.min_overlap:
            rule, measured, threshold = "min_overlap", overlap, options.min_overlap
        return Pass(
            scene_id=scene_id,
            entry_ns=entry_ns,
            exit_ns=exit_ns,
            entry_kind=_KINDS[entry_kind],
            exit_kind=_KINDS[exit_kind],
            entry=(entry_1, entry_2),
            exit=(exit_1, exit_2),
            duration_s=duration_s,
            path_m=path_m,
            inside_path_m=inside_m,
            overlap=overlap,
            visits=visits,
            split=split,
            poses=poses,
            closest_m=closest_m,
            heading_in_deg=None if math.isnan(heading_in) else heading_in,
            heading_out_deg=None if math.isnan(heading_out) else heading_out,
            rule=rule,
            measured=measured,
            threshold=threshold,
        )


def _whole(track: CleanTrack) -> Records:
    """The whole track as one candidate."""
    kept = track.kept()
    clip = np.zeros(1, VISIT)
    for side, position in (("entry", kept[0]), ("exit", kept[-1])):
        clip[f"{side}_ns"] = track.timestamp_ns[position]
        clip[f"{side}_first"], clip[f"{side}_second"] = track.first[position], track.second[position]
        clip[f"{side}_kind"] = RECORDING_EDGE
    clip["start"], clip["stop"] = kept[0], kept[-1] + 1
    return clip
