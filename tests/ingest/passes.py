"""What the tests of triggers share: a straight drive, cleaned and judged in one call, and the passes of a folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mirror.ingest.clean import clean
from mirror.ingest.passes import DrivePasses, find_drive_passes, fingerprint
from mirror.ingest.trigger import Pass, RoiTrigger
from mirror.recordings.protocol import Track
from mirror.recordings.registry import open_recording
from mirror.schema.documents import CleaningOptions, Roi, TriggerOptions
from tests.builders.folder import SCENE
from tests.ingest.drives import T0_NS, Place


def run(
    track: Track,
    rois: Roi | list[Roi],
    *,
    clip: bool = False,
    cleaning: CleaningOptions | None = None,
    **options: object,
) -> list[Pass]:
    cleaning, chosen = cleaning or CleaningOptions(), TriggerOptions(**options)
    listed = rois if isinstance(rois, list) else [rois]
    cleaned, _ = clean(track, cleaning, min_step_m=chosen.min_step_m)
    return RoiTrigger(listed, chosen, cleaning).passes(cleaned, frame=listed[0].frame if listed else None, is_clip=clip)


def passes_of_folder(path: Path) -> DrivePasses:
    """Return the passes of a recording in the `folder` format through the scene of its street."""
    recording, cleaning = open_recording(path), CleaningOptions()
    source = fingerprint(recording, "folder", path.name)
    return find_drive_passes(
        path, recording, source, RoiTrigger([SCENE], TriggerOptions(), cleaning), [SCENE], cleaning
    )


def straight(
    place: Place, speed: float, half_m: float, *, hz: float = 10.0, y_m: float = 0.0, phase: float = 0.0
) -> Track:
    """East along y from x = -half to half; at x = 0 the time is half / speed."""
    t = np.arange(0.0, 2.0 * half_m / speed + 1e-9, 1.0 / hz) + phase
    return place.track(t, np.column_stack([t * speed - half_m, np.full(len(t), y_m)]))


def seconds(one: Pass) -> tuple[float, float]:
    return (one.entry_ns - T0_NS) * 1e-9, (one.exit_ns - T0_NS) * 1e-9
