"""Makes the clips of the study: busy drives by day through two worlds; resumable, one file for each clip."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.studies.generation.street_clips import RATE_HZ, StreetRecorder, StreetRig, busy_drive
from hybridworldsim.generation.clips.clip import ABSENT
from hybridworldsim.generation.clips.folder import ClipList, clip_path, write_clip, write_list
from mirror.arrays import AnyArray
from mirror.errors import MirrorError
from mirror.progress import ProgressReporter
from mirror.schema.files import write_bytes

PRESET: Final = "benchmark"
ROUTES: Final = (
    "guangzhou-urban-01", "guangzhou-urban-05", "guangzhou-urban-07",
    "karlsruhe-campus-02", "karlsruhe-campus-04", "karlsruhe-campus-08",
)  # fmt: skip
"""Drives by day of the preset's urban scene and of its campus: along, left, turn; back, turn, turn."""
BUSTLE: Final = 1.2
TRAINING_SEEDS: Final = tuple(range(1, 7))
TEST_SEEDS: Final = (101, 102)
CLIP_FRAMES: Final = 26
TEST_FRAMES: Final = 126
_LEAST_MOVE_M: Final = 3.0
_LEAST_PX: Final = 60
_LOOKED_AT: Final = 5
"""Of so many frames, one tells whether a clip is busy: it costs a tenth of recording the clip."""
_LEAST_BUSY: Final = 0.3


@dataclass(frozen=True)
class PlannedDrive:
    """One drive of the study.

    Attributes:
        route: the preset's drive, for its world, route and vehicle.
        seed: seed of its traffic.
        test: whether it is scored on, not trained on.
    """

    route: str
    seed: int
    test: bool

    @property
    def drive_id(self) -> str:
        """Id of the drive."""
        return f"{self.route}-s{self.seed}"


def planned_drives() -> list[PlannedDrive]:
    """List test drives, then training drives.

    Seeds change within worlds, so that early results mix all routes.
    """
    drives = [PlannedDrive(route, seed, True) for seed in TEST_SEEDS for route in ROUTES]
    return drives + [PlannedDrive(route, seed, False) for seed in TRAINING_SEEDS for route in ROUTES]


def make_clips(folder: Path, progress: ProgressReporter, *, with_maps: bool = False) -> ClipList:
    """Make all clips that do not exist yet, then the list.

    Args:
        folder: folder of the clips; those with and without maps need folders of their own.
        progress: receives the progress.
        with_maps: whether clips have the lines of the exact map; those of the study have none.
    """
    kept: dict[bool, list[str]] = {False: [], True: []}
    drives = planned_drives()
    progress.start("clips", len(drives))
    for drive in drives:
        done = folder / "drives" / f"{drive.drive_id}.txt"
        if not done.is_file():
            write_bytes(done, "\n".join(_record(folder, drive, progress, with_maps)).encode())
        kept[drive.test] += done.read_text().split()
        progress.advance(1)
        progress.report(f"{drive.drive_id}: {len(kept[False])} training clips, {len(kept[True])} test clips")
    source = f"{PRESET}, bustle {BUSTLE}, {len(drives)} drives{', with maps' if with_maps else ''}"
    clips = ClipList(source=source, training=tuple(kept[False]), test=tuple(kept[True]))
    write_list(folder, clips)
    return clips


def _record(folder: Path, planned: PlannedDrive, progress: ProgressReporter, with_maps: bool) -> Iterator[str]:
    """Record a drive; yields the ids of its clips."""
    drive = busy_drive(PRESET, planned.route, planned.seed, BUSTLE, planned.drive_id)
    try:
        recorder = StreetRecorder(drive, StreetRig())
    except MirrorError as error:
        progress.message(f"{planned.drive_id} is left out: {error}")
        return
    times_s = recorder.times_s
    moved_m = np.linalg.norm(np.diff(recorder.ego(times_s).translation, axis=0), axis=1)
    driven_m = np.concatenate([[0.0], np.cumsum(moved_m)])
    for first, last in _windows(driven_m, planned.test):
        clip_id = f"{planned.drive_id}-{round(times_s[first] * RATE_HZ):03d}"
        if not planned.test and busy_share(recorder.tracks(times_s[first:last:_LOOKED_AT])) < _LEAST_BUSY:
            continue
        if not clip_path(folder, clip_id).is_file():
            write_clip(folder, recorder.record(clip_id, times_s[first:last], with_map=with_maps))
        yield clip_id


def _windows(driven_m: np.ndarray, test: bool) -> list[tuple[int, int]]:
    """First and last frame (exclusive) of the clips of a drive in which the vehicle moves."""
    if test:
        first = int(np.searchsorted(driven_m, _LEAST_MOVE_M))
        return [(first, min(first + TEST_FRAMES, len(driven_m)))]
    windows = [(first, first + CLIP_FRAMES) for first in range(0, len(driven_m) - CLIP_FRAMES + 1, CLIP_FRAMES)]
    return [(first, last) for first, last in windows if driven_m[last - 1] - driven_m[first] >= _LEAST_MOVE_M]


def busy_share(tracks: AnyArray) -> float:
    """Return the share of frames of masks (F, V, H, W) in which some view shows a road user with at least 60 pixels."""
    shown = [
        any(np.bincount(view[view != ABSENT].astype(np.int64), minlength=1).max() >= _LEAST_PX for view in frame)
        for frame in tracks
    ]
    return float(np.mean(shown))
