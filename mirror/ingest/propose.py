"""Where to put regions of interest: the places that most separate traversals pass.

The paper selects such points by hand. Here every place that was driven is a candidate: tracks are laid on a grid, the
exact trigger judges a circle at each cell that at least two drives, or two visits of one, come near, and the best
circles that do not overlap are kept.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.errors import MirrorError, RecordingError, UsageError
from mirror.ingest.clean import CleanTrack
from mirror.ingest.metric import scales
from mirror.ingest.request import IngestOptions, validate_thresholds
from mirror.ingest.trigger import RoiTrigger
from mirror.ingest.usable import clean_usable
from mirror.progress import NullProgress, ProgressReporter
from mirror.recordings.boundary import reader_errors
from mirror.recordings.registry import open_recording
from mirror.schema.documents import CleaningOptions, Roi, TriggerOptions

_STEP_M = 20.0
_CELLS_A_RADIUS = 4
_FINALISTS = 2000


@dataclass(frozen=True)
class Proposal:
    """One proposed region of interest.

    Attributes:
        roi: the circle.
        traversals: accepted passes.
        drives: drives with an accepted pass.
        refused: passes that the rules refuse.
        duration_s: sum over the accepted passes.
        path_m: sum over the accepted passes.
    """

    roi: Roi
    traversals: int
    drives: int
    refused: int
    duration_s: float
    path_m: float


@dataclass(frozen=True)
class _DriveTrack:
    drive_id: str
    track: CleanTrack
    frame: str | None
    is_clip: bool


@dataclass(frozen=True)
class SparseDrives:
    """Drives whose fixes are so far apart that gaps cut the drives to pieces.

    Attributes:
        drives: how many; over half of the time of each lies in gaps over ``max_gap_s``.
        of: how many drives there are.
        max_gap_s: the threshold.
        spacing_s: a threshold that all but a twentieth of their gaps keep.
    """

    drives: int
    of: int
    max_gap_s: float
    spacing_s: float


@dataclass(frozen=True)
class Proposals:
    """The result of `propose_rois`.

    Attributes:
        ranked: the proposals, best first.
        failures: recordings that could not be read.
        sparse: drives whose fixes are too far apart for the trigger; None: there are none.
    """

    ranked: tuple[Proposal, ...]
    failures: tuple[tuple[Path, MirrorError], ...]
    sparse: SparseDrives | None = None


def propose_rois(
    recordings: Sequence[Path],
    *,
    count: int = 10,
    radius_m: float = 200.0,
    prefix: str = "roi",
    options: IngestOptions | None = None,
    progress: ProgressReporter | None = None,
) -> Proposals:
    """Rank centres of regions of interest by the number of drives that have a traversal there.

    One drive may pass a place several times, and a stop on the way makes two traversals of one pass: so drives count
    before traversals.

    Args:
        recordings: one path a drive; poses are read, images are not.
        count: how many ROIs at most.
        radius_m: their radius.
        prefix: of their ids: ``prefix_1`` is the best.
        options: reader, thresholds and workers as for ingest.
        progress: receives each finished recording.

    Returns:
        ROIs whose circles do not overlap, by drives, then accepted passes, then driven length.
    """
    options, progress = options or IngestOptions(), progress or NullProgress()
    trigger_options = validate_thresholds(TriggerOptions, options.trigger)
    cleaning = validate_thresholds(CleaningOptions, options.cleaning)
    if options.workers < 1:
        raise UsageError(f"{options.workers} workers", expected="at least one")
    if not 0.0 < radius_m <= 20_000.0:
        raise UsageError(f"a radius of {radius_m:g} m", place="--radius-m", expected="more than 0, at most 20,000 m")
    driven: list[_DriveTrack] = []
    failures: list[tuple[Path, MirrorError]] = []
    progress.start("reading poses", len(recordings))

    def read(path: Path) -> _DriveTrack | tuple[Path, MirrorError]:
        try:
            with reader_errors(path):
                recording = open_recording(path, reader=options.reader, options=options.reader_options)
                info = recording.info
                _, track, _ = clean_usable(
                    recording.track(),
                    cleaning,
                    trigger_options,
                    is_clip=info.is_clip,
                    has_motion=info.has_motion,
                )
        except RecordingError as error:
            return path, error
        finally:
            progress.advance(1)
        return _DriveTrack(info.drive_id, track, info.frame, info.is_clip)

    with ThreadPoolExecutor(max_workers=options.workers) as pool:
        for result in pool.map(read, recordings):
            if isinstance(result, _DriveTrack):
                driven.append(result)
            elif options.fail_fast:
                raise result[1]
            else:
                failures.append(result)
    ranked: list[Proposal] = []
    for frame in sorted({one.frame for one in driven}, key=str):
        tracks = [one for one in driven if one.frame == frame]
        centres = _candidates(tracks, radius_m)
        rois = [_roi(frame, place, radius_m, f"candidate_{number}") for number, place in enumerate(centres)]
        ranked += _judge(tracks, rois, RoiTrigger(rois, trigger_options, cleaning))
    ranked.sort(key=lambda one: (-one.drives, -one.traversals, -one.path_m, one.roi.scene_id))
    chosen: list[Proposal] = []
    for one in ranked:
        if len(chosen) == count:
            break
        if one.traversals and all(_apart(one.roi, other.roi) for other in chosen):
            named = one.roi.model_copy(update={"scene_id": f"{prefix}_{len(chosen) + 1}"})
            chosen.append(Proposal(named, one.traversals, one.drives, one.refused, one.duration_s, one.path_m))
    return Proposals(tuple(chosen), tuple(failures), _sparse(driven, trigger_options.max_gap_s))


def _sparse(driven: Sequence[_DriveTrack], max_gap_s: float) -> SparseDrives | None:
    gaps: list[Float64] = []
    for one in driven:
        steps_s = np.diff(one.track.timestamp_ns[one.track.kept()]) * 1e-9
        # A clip is judged whole, whatever its gaps.
        if not one.is_clip and steps_s[steps_s > max_gap_s].sum() > 0.5 * steps_s.sum():
            gaps.append(steps_s)
    if not gaps:
        return None
    spacing_s = math.ceil(float(np.quantile(np.concatenate(gaps), 0.95)))
    return SparseDrives(len(gaps), len(driven), max_gap_s, max(float(spacing_s), math.floor(max_gap_s) + 1.0))


def _candidates(tracks: Sequence[_DriveTrack], radius_m: float) -> Float64:
    """Centres worth judging, (N, 2): mean driven places of grid cells, those near most drives, then visits, first.

    A cell is a fraction of the radius wide; a visit is counted to every cell within the radius.
    """
    geodetic = tracks[0].track.geodetic
    kept = [one.track.kept() for one in tracks]
    places = [np.column_stack([one.track.lon_or_x[rows], one.track.lat_or_y[rows]]) for one, rows in zip(tracks, kept)]
    middle = np.median(np.concatenate([place[:: max(1, len(place) // 1000)] for place in places]), axis=0)
    scale = np.array(scales(float(middle[1]), geodetic))
    size = radius_m / _CELLS_A_RADIUS
    reach = [
        (dx, dy)
        for dx in range(-_CELLS_A_RADIUS, _CELLS_A_RADIUS + 1)
        for dy in range(-_CELLS_A_RADIUS, _CELLS_A_RADIUS + 1)
        if math.hypot(dx, dy) <= _CELLS_A_RADIUS
    ]
    sums: dict[tuple[int, int], Float64] = defaultdict(lambda: np.zeros(3))
    near: Counter[tuple[int, int]] = Counter()
    drives: Counter[tuple[int, int]] = Counter()
    for place, one, rows in zip(places, tracks, kept):
        cells, entered_ns = _cells_in_order(place, middle, scale, size, one.track.timestamp_ns[rows])
        seen_ns: dict[tuple[int, int], int] = {}
        for cell, mean, stamp in zip(
            map(tuple, cells.tolist()), _means(place, middle, scale, size), entered_ns.tolist()
        ):
            sums[cell] += (*mean, 1.0)
            for dx, dy in reach:
                around = (cell[0] + dx, cell[1] + dy)
                # Back within the radius after a minute away: another visit.
                if around not in seen_ns or stamp - seen_ns[around] > 60_000_000_000:
                    near[around] += 1
                seen_ns[around] = stamp
        drives.update(seen_ns.keys())
    best = sorted(sums, key=lambda cell: (-drives[cell], -near[cell], cell))[:_FINALISTS]
    return np.array([sums[cell][:2] / sums[cell][2] / scale + middle for cell in best]).reshape(-1, 2)


def _cells_in_order(place: Float64, middle: Float64, scale: Float64, size: float, stamps: Int64) -> tuple[Int64, Int64]:
    """The grid cells that a track enters, one after the other, and when."""
    cells = np.floor((place - middle) * scale / size).astype(np.int64)
    entered = np.concatenate([[True], (np.diff(cells, axis=0) != 0).any(axis=1)])
    return cells[entered], stamps[entered]


def _means(place: Float64, middle: Float64, scale: Float64, size: float) -> Float64:
    """The mean place, in metres from the middle, of each stay in a cell; the order is that of `_cells_in_order`."""
    metres = (place - middle) * scale
    cells = np.floor(metres / size).astype(np.int64)
    entered = np.flatnonzero(np.concatenate([[True], (np.diff(cells, axis=0) != 0).any(axis=1)]))
    lengths = np.diff(np.append(entered, len(place)))
    return np.add.reduceat(metres, entered, axis=0) / lengths[:, None]


def _roi(frame: str | None, place: Float64, radius_m: float, name: str) -> Roi:
    lon_or_x, lat_or_y = (round(float(value), 7 if frame is None else 3) for value in place)
    if frame is None:
        return Roi(scene_id=name, longitude_deg=lon_or_x, latitude_deg=lat_or_y, radius_m=radius_m)
    return Roi(scene_id=name, frame=frame, x_m=lon_or_x, y_m=lat_or_y, radius_m=radius_m)


def _judge(tracks: Sequence[_DriveTrack], rois: Sequence[Roi], trigger: RoiTrigger) -> list[Proposal]:
    accepted: Counter[str] = Counter()
    refused: Counter[str] = Counter()
    drives: dict[str, set[str]] = defaultdict(set)
    duration: Counter[str] = Counter()
    path: Counter[str] = Counter()
    for one in tracks:
        for judged in trigger.passes(one.track, frame=one.frame, is_clip=one.is_clip):
            scene = judged.scene_id
            if not judged.accepted:
                refused[scene] += 1
                continue
            accepted[scene] += 1
            drives[scene].add(one.drive_id)
            duration[scene] += judged.duration_s  # type: ignore[assignment]
            path[scene] += judged.path_m  # type: ignore[assignment]
    return [
        Proposal(
            roi,
            accepted[roi.scene_id],
            len(drives[roi.scene_id]),
            refused[roi.scene_id],
            duration[roi.scene_id],
            path[roi.scene_id],
        )
        for roi in rois
    ]


def _apart(one: Roi, other: Roi) -> bool:
    """Return whether two circles do not overlap; circles of different frames never do."""
    from mirror.geometry.geodesy import surface_distance_m

    if one.frame != other.frame:
        return True
    if one.x_m is not None and one.y_m is not None and other.x_m is not None and other.y_m is not None:
        distance = math.hypot(one.x_m - other.x_m, one.y_m - other.y_m)
    else:
        places = [one.longitude_deg, one.latitude_deg, other.longitude_deg, other.latitude_deg]
        distance = float(surface_distance_m(*[float(value or 0.0) for value in places]))
    return distance >= one.radius_m + other.radius_m
