"""Writes the recordings of a preset."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

from mirror.errors import UsageError
from mirror.pools import thread_pool
from mirror.progress import NullProgress, ProgressReporter
from mirror.schema.documents import CANONICAL_CAMERAS, Roi
from mirror.schema.files import write_json
from mirror.schema.road_map import write_road_map
from mirror.synth.errors import Errors
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.fleet.drives import make_drives
from mirror.synth.fleet.presets import Preset, resolve_preset
from mirror.synth.light.condition import Effects
from mirror.synth.maps import street_map
from mirror.synth.rigs import CameraReadout
from mirror.synth.rigs.readouts import require_shorter
from mirror.synth.seeds import draw_secret_seed, require_public_seed
from mirror.synth.writing.images import FrameImages, write_cameras, write_image_references, write_images
from mirror.synth.writing.journal import SECRET_SEED, Counts, Journal, open_journal
from mirror.synth.writing.poses import pose_stamps, write_poses
from mirror.synth.writing.schedule import ImageSchedule, schedule_images
from mirror.synth.writing.secret import read_secret, write_secret
from mirror.synth.writing.truth import RENDERED, TruthKind, write_truth
from mirror.version import __version__

LICENCE: Final = "CC0-1.0"
MAPS: Final = "maps"
"""Folder of the scenes' exact road maps, beside the recordings."""


@dataclass
class SynthReport:
    """The written recordings and their counts.

    Attributes:
        recordings: folders of the recordings.
        images: number of images written or referred to.
        lost: number of images that were lost.
        boxes: number of boxes.
        unseen: number of nearby road users, over all instants, that have no box because no image shows them.
    """

    recordings: list[Path] = field(default_factory=list)
    images: int = 0
    lost: int = 0
    boxes: int = 0
    unseen: int = 0

    def count(self, folder: Path, counts: Counts) -> None:
        """Add a recording and its counts."""
        self.recordings.append(folder)
        self.images += counts.pictures
        self.lost += counts.lost
        self.boxes += counts.boxes
        self.unseen += counts.unseen


def write_recordings(
    out: Path,
    preset: str = "tiny",
    seed: int = 0,
    *,
    secret: bool = False,
    scenes: int | None = None,
    traversals: int | None = None,
    errors: Errors | None = None,
    effects: Effects | None = None,
    readouts: Sequence[CameraReadout] = (),
    truth: Sequence[TruthKind] = (),
    workers: int | None = None,
    progress: ProgressReporter | None = None,
) -> SynthReport:
    """Write the recordings of a preset, with ``rois.geojson`` and the scenes' exact road maps beside them.

    The files depend on the arguments only, not on the number of workers. ``recording.json`` is written last. A
    second call with the same arguments keeps the complete recordings and writes the missing ones.

    With ``secret``, a seed of 128 random bits is drawn in place of ``seed`` and written to ``secret.json`` alone. Every
    other file is free of it.

    Args:
        out: a new or an empty folder, or one with an unfinished run of the same arguments.
        preset: one of `mirror.synth.PRESETS`.
        seed: public seed of all random choices.
        secret: draw a secret seed, or continue with that of the folder.
        scenes: number of scenes; default: all scenes of the preset.
        traversals: number of drives with images through each scene; default: the preset's number.
        errors: measurement errors of the recordings; default: the preset's errors.
        effects: effects of light, weather and cameras to be rendered; default: all.
        readouts: rolling shutters of cameras; the others have global ones.
        truth: kinds of ground truth to be written beside each recording.
        workers: number of threads; default: the number of processors.
        progress: receives the number of images of each recording and every written image; default: no report.

    Returns:
        The folders of the recordings and their counts.

    Raises:
        UsageError: the preset does not exist, the number of workers is below 1, the folder holds other files, or
            ``truth`` names image truth of a preset without rendered images, or both ``seed`` and ``secret`` are given.
        DatasetError: the folder is not writable, the disk is full, another run is writing to the folder, or the secret
            seed of its recordings is missing.
    """
    if workers is not None and workers < 1:
        raise UsageError(f"{workers} workers", place="--workers", expected="at least one")
    require_public_seed(seed)
    settings, _, _ = resolve_preset(preset, scenes, traversals)
    errors = settings.errors if errors is None else errors
    if secret:
        _require_secret(settings, seed)
    if settings.on_demand:
        _require_on_demand(preset, effects, truth, readouts)
    require_shorter(readouts, settings.image_hz)
    progress = NullProgress() if progress is None else progress
    arguments = {
        "toolkit": __version__,
        "preset": preset,
        "seed": SECRET_SEED if secret else str(seed),
        "scenes": str(scenes),
        "traversals": str(traversals),
        "errors": str(errors),
        "effects": str(effects),
        "truth": ",".join(sorted(set(truth))),
    }
    if readouts:
        # absent without rolling shutters, so that the named presets keep their bytes
        arguments["rolling_shutter"] = ",".join(
            f"{readout.camera}={readout.direction}:{readout.readout_ns}" for readout in readouts
        )
    written = SynthReport()
    with open_journal(out, arguments) as done, thread_pool(workers or os.cpu_count() or 1) as pool:
        if secret:
            seed = _draw_or_read_secret(out, done)
        _, drives = make_drives(preset, seed, scenes, traversals)
        if effects is not None:
            drives = [replace(drive, condition=replace(drive.condition, effects=effects)) for drive in drives]
        if readouts:
            drives = [replace(drive, vehicle=replace(drive.vehicle, readouts=tuple(readouts))) for drive in drives]
        write_json(out / "rois.geojson", _geojson([drive.roi for drive in drives]))
        missing = [drive for drive in drives if done.find_complete(drive.drive_id) is None]
        ahead = [pool.submit(_simulate, drive) for drive in missing[:1]]
        for number, drive in enumerate(drives, start=1):
            folder = out / drive.drive_id
            counts = done.find_complete(drive.drive_id)
            if counts is None:
                ahead.pop().result()
                # The next drive is simulated while the images of this drive are rendered.
                missing = missing[1:]
                ahead = [pool.submit(_simulate, coming) for coming in missing[:1]]
                _write_map(out, drive)
                start = partial(progress.start, f"recording {number} of {len(drives)}, images")
                counts = _write(folder, drive, seed, errors, truth, pool, start, progress.advance)
                done.add(drive.drive_id, counts)
                drive.forget()
            written.count(folder, counts)
    return written


def _require_secret(preset: Preset, seed: int) -> None:
    """Refuse a secret seed beside a public one, and for a preset whose images have URIs with the seed."""
    if seed:
        raise UsageError(
            "a public and a secret seed", place="--secret", expected="one of them", remedy="leave out --seed"
        )
    if preset.on_demand:
        raise UsageError(
            f"a secret seed with preset {preset.name!r}",
            place="--secret",
            expected="a preset that writes its images: the URIs of images on demand name the seed",
            remedy="take another --preset",
        )


def _draw_or_read_secret(out: Path, done: Journal) -> int:
    """Return the secret seed of a folder; a new folder gets one."""
    if done.is_new:
        seed = draw_secret_seed()
        write_secret(out, seed)
        return seed
    return read_secret(out)


def _require_on_demand(
    preset: str, effects: Effects | None, truth: Sequence[TruthKind], readouts: Sequence[CameraReadout]
) -> None:
    """Refuse effects, image truth and rolling shutters for a preset whose images are rendered when they are loaded."""
    if readouts:
        raise UsageError(
            f"rolling shutters with preset {preset!r}",
            place="--rolling-shutter",
            expected="global ones: its images are rendered when they are loaded, from URIs that do not name a shutter",
            remedy="take another --preset",
        )
    if effects is not None:
        raise UsageError(
            f"effects left out of preset {preset!r}",
            expected="all: its images are rendered when they are loaded",
            remedy="take another preset",
        )
    if RENDERED & set(truth):
        raise UsageError(
            f"truth of kinds {', '.join(sorted(RENDERED & set(truth)))} with preset {preset!r}",
            expected="poses alone: its images are rendered when they are loaded",
            remedy="take another preset",
        )


def _write_map(out: Path, drive: SynthDrive) -> None:
    """Write the exact map of a drive's scene beside the recordings, once."""
    path = out / MAPS / f"{drive.roi.scene_id}.parquet"
    if not path.is_file():
        write_road_map(path, street_map(drive.world.plan))


def _simulate(drive: SynthDrive) -> None:
    _ = drive.truth


def _write(
    folder: Path,
    drive: SynthDrive,
    seed: int,
    errors: Errors,
    truth: Sequence[TruthKind],
    pool: ThreadPoolExecutor,
    start: Callable[[int], None],
    advance: Callable[[int], None],
) -> Counts:
    counts: Counter[str] = Counter()
    write_poses(folder, drive, errors)
    schedule: ImageSchedule | None = None
    truth_boxes: list[dict[str, Any]] = []
    if drive.recipe.images:
        schedule = schedule_images(drive, errors)
        counts["lost"] = sum(int((~kept).sum()) for kept in schedule.kept.values())
        start(sum(int(kept.sum()) for kept in schedule.kept.values()))
        write_cameras(folder, drive, schedule, errors)
        if drive.preset.on_demand:
            frames: Iterable[FrameImages] = [write_image_references(folder, drive, schedule, seed)]
        else:
            frames = write_images(folder, drive, schedule, truth, pool)
        for frame in frames:
            counts.update(pictures=frame.images, boxes=frame.boxes.num_rows, unseen=frame.unseen)
            advance(frame.images)
            truth_boxes += frame.truth_boxes
    if truth:
        write_truth(folder, drive, truth, pose_stamps(drive), schedule, truth_boxes)
    write_json(folder / "recording.json", _document(drive))
    return Counts(**counts)


def _geojson(rois: Sequence[Roi]) -> dict[str, object]:
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [roi.longitude_deg, roi.latitude_deg]},
            "properties": roi.model_dump(mode="json", exclude_none=True),
        }
        for roi in {roi.scene_id: roi for roi in rois}.values()
    ]
    return {"type": "FeatureCollection", "features": features}


def _document(drive: SynthDrive) -> dict[str, object]:
    images = drive.recipe.images
    document: dict[str, object] = {
        "format": "mirror-folder",
        "version": "1.0",
        "drive_id": drive.drive_id,
        "vehicle_id": drive.vehicle.vehicle_id,
        "vehicle_type": drive.vehicle.kind.name,
        "rig_id": drive.rig_id if images else None,
        "time_base": "gps_us" if drive.recipe.poses == "gps" else "unix_ns",
        "frame": {"kind": "wgs84"},
        "body_frame": "ego",
        "city": drive.roi.city,
        "weather": drive.recipe.weather,
        "licence": LICENCE,
    }
    if images:
        document["reference_camera"] = CANONICAL_CAMERAS[0]
        document["cameras"] = {
            name: {"static_mask": f"masks/{name}.png" if name in drive.ego_masks else None}
            for name in CANONICAL_CAMERAS
        }
    return document
