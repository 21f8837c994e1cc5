"""Rules of TIM: timestamps of images, frames and drives."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from itertools import pairwise

import numpy as np

from mirror.integrity.dataset_view import DatasetView
from mirror.integrity.finding import Finding, Severity
from mirror.integrity.rule import dataset_rule, scene_rule
from mirror.integrity.scene_view import SceneView
from mirror.schema.documents import DriveDocument


@scene_rule(
    "TIM001",
    Severity.ERROR,
    title="The timestamp of an image is not within its exposure, or the exposure ends before it starts.",
    remedy="correct the stamps in the recording, and `mirror ingest RECORDING... --replace`",
)
def _exposure(view: SceneView) -> Iterator[Finding]:
    images = view.all_images
    start, middle, end = (images.integers(name) for name in ("exposure_start_ns", "timestamp_ns", "exposure_end_ns"))
    yield from images.findings(
        (start > middle) | (middle > end),
        lambda row: f"exposure from {start[row]} to {end[row]}; expected start <= timestamp_ns <= end",
    )


@scene_rule(
    "TIM002",
    Severity.ERROR,
    title=("A camera's exposures do not follow each other: one starts or ends before the one of an earlier image."),
    remedy="correct the stamps in the recording, and `mirror ingest RECORDING... --replace`",
)
def _camera_clock(view: SceneView) -> Iterator[Finding]:
    images = view.images
    same = images.same_group("camera")
    stamps = images.integers("timestamp_ns")
    back = np.zeros(len(images), np.bool_)
    for name in ("exposure_start_ns", "exposure_end_ns"):
        values = images.integers(name)
        back[1:] |= (values[1:] < values[:-1]) & (stamps[1:] > stamps[:-1])
    yield from images.findings(
        same & back,
        lambda row: (
            f"exposure from {images.integers('exposure_start_ns')[row]} to"
            f" {images.integers('exposure_end_ns')[row]}, that of the image before it from"
            f" {images.integers('exposure_start_ns')[row - 1]} to {images.integers('exposure_end_ns')[row - 1]}"
        ),
    )


@scene_rule(
    "TIM003",
    Severity.ERROR,
    title="An image is more than half a period away from the reference exposure of its frame.",
    remedy="`mirror ingest RECORDING... --replace`: its frames were put together wrongly",
)
def _frame_sync(view: SceneView) -> Iterator[Finding]:
    images = view.images
    frames = view.frames
    off_s = np.abs(images.integers("timestamp_ns") - frames.reference_ns) * 1e-9
    limit_s = 0.5 * frames.period_s[images.traversal]
    yield from images.findings(
        frames.framed & (off_s > limit_s + 1e-9),
        lambda row: (
            f"{off_s[row] * 1e3:.3f} ms from frame {images.integers('frame_index')[row]};"
            f" expected at most {limit_s[row] * 1e3:.3f} ms"
        ),
        worst=np.where(frames.framed, off_s, 0.0),
    )


@scene_rule(
    "TIM004",
    Severity.ERROR,
    title=("Frames do not count from 0 along the reference camera, or one has two images of a camera, or none of it."),
    remedy="`mirror ingest RECORDING... --replace`: its frames were put together wrongly",
)
def _frame_numbers(view: SceneView) -> Iterator[Finding]:
    images = view.images
    if not len(images):
        return
    frames = view.frames
    index = images.integers("frame_index")
    known = images.is_known("frame_index")
    same = images.same_group("camera")
    expected = np.arange(len(images)) - np.maximum.accumulate(np.where(same, 0, np.arange(len(images))))
    miscounted = frames.is_reference & ~(known & (index == expected))
    yield from images.findings(
        miscounted,
        lambda row: (
            f"image {expected[row]} of the reference camera has frame_index {index[row] if known[row] else 'null'}"
        ),
    )
    order = np.lexsort((index, images.text_codes("camera")[0], images.owner))
    again = (
        (np.diff(index[order]) == 0)
        & (np.diff(images.text_codes("camera")[0][order]) == 0)
        & (np.diff(images.owner[order]) == 0)
        & known[order][1:]
        & known[order][:-1]
    )
    repeated = np.zeros(len(images), np.bool_)
    repeated[order[1:][again]] = True
    lost = known & ~frames.framed & frames.has_reference[images.traversal]
    yield from images.findings(
        (repeated | lost) & ~miscounted & ~frames.is_reference,
        lambda row: f"frame {index[row]} has {'another image of the camera' if repeated[row] else 'no reference'}",
    )


_PERIODS = 1.5


@scene_rule(
    "TIM005",
    Severity.WARNING,
    title="A camera pauses: two of its images are more than one and a half of its periods apart.",
    remedy="check the recording for dropped images; loaders leave them out",
)
def _camera_gap(view: SceneView) -> Iterator[Finding]:
    images = view.images
    stamps = images.integers("timestamp_ns")
    step_s = np.full(len(images), np.nan)
    period_s = np.full(len(images), np.nan)
    for start, stop in pairwise(images.runs("camera").tolist()):
        if stop - start > 2:
            step_s[start + 1 : stop] = np.diff(stamps[start:stop]) * 1e-9
            period_s[start:stop] = np.median(step_s[start + 1 : stop])
    yield from images.findings(
        step_s > _PERIODS * period_s,
        lambda row: (
            f"{step_s[row] * 1e3:.1f} ms after the camera's image before it; its period is {period_s[row] * 1e3:.1f} ms"
        ),
        worst=step_s,
    )


@scene_rule(
    "TIM006",
    Severity.WARNING,
    title="Frames lack a camera that the traversal otherwise has; its first and last frame may.",
    remedy="nothing, if the images were not recorded: loaders give frames without them",
)
def _missing_camera(view: SceneView) -> Iterator[Finding]:
    images = view.images
    frames = view.frames
    cameras, names = images.text_codes("camera")
    index = images.integers("frame_index")
    for file, _, rows in images.slices():
        framed = np.flatnonzero(frames.framed[rows]) + rows.start
        inner = np.unique(index[framed])[1:-1]
        for camera in np.unique(cameras[framed]).tolist():
            missing = np.setdiff1d(inner, index[framed[cameras[framed] == camera]])
            if len(missing):
                yield Finding(
                    file,
                    f"camera {names[camera]}, frame {missing[0]}",
                    f"no image in {len(missing)} of {len(inner) + 2} frames",
                    len(missing),
                )


YEAR_2000_NS = 946_684_800_000_000_000


YEAR_2100_NS = 4_102_444_800_000_000_000


@scene_rule(
    "TIM007",
    Severity.ERROR,
    title=(
        "A timestamp is not in the years 2000 to 2099, and its drive does not declare a clock without a date: another"
        " time base, or a clock that was not set."
    ),
    remedy="state the source's time base to the reader, and `mirror ingest RECORDING... --replace`",
)
def _epoch(view: SceneView) -> Iterator[Finding]:
    dated = np.array([item.drive.has_date for item in view.traversals], np.bool_)
    for rows in (view.all_poses, view.all_images, view.boxes, view.masks):
        stamps = rows.integers("timestamp_ns")
        yield from rows.findings(
            dated[rows.traversal] & ((stamps < YEAR_2000_NS) | (stamps >= YEAR_2100_NS)),
            lambda row, stamps=stamps: f"{np.datetime64(int(stamps[row]), 'ns')}; expected 2000 to 2099",  # type: ignore[misc]
        )


@dataset_rule(
    "TIM008",
    Severity.WARNING,
    title="Two drives of one vehicle overlap in time: it cannot be in two places.",
    remedy="remove one of two recordings of the same drive, or correct the vehicle's id",
)
def _one_vehicle(view: DatasetView) -> Iterator[Finding]:
    by_vehicle: dict[str, list[tuple[int, str, DriveDocument]]] = defaultdict(list)
    for name, drive in view.drives.items():
        if not drive.has_date:
            # The clocks of two such drives have no common start.
            continue
        by_vehicle[drive.vehicle_id].append((drive.start_ns, name, drive))
    for vehicle_id, own in by_vehicle.items():
        own.sort(key=lambda item: item[:2])
        longest = own[0]
        for start_ns, name, drive in own[1:]:
            overlap_s = (min(longest[2].end_ns, drive.end_ns) - start_ns) * 1e-9
            if overlap_s > 0:
                yield Finding(
                    f"drives/{name}/drive.json",
                    "start_ns",
                    f"vehicle {vehicle_id} is in drive {longest[1]} at the same time, for {overlap_s:.1f} s",
                )
            if drive.end_ns > longest[2].end_ns:
                longest = (start_ns, name, drive)


@scene_rule(
    "TIM009",
    Severity.ERROR,
    title="An image was taken before the entry or after the exit of its pass.",
    remedy="`mirror ingest RECORDING... --replace`",
)
def _outside_pass(view: SceneView) -> Iterator[Finding]:
    images = view.images
    stamps = images.integers("timestamp_ns")
    entry, end = view.entry_ns[images.traversal], view.exit_ns[images.traversal]
    outside_s = np.maximum(entry * 1e-9 - stamps * 1e-9, stamps * 1e-9 - end * 1e-9)
    yield from images.findings(
        (stamps < entry) | (stamps > end),
        lambda row: f"{outside_s[row]:.3f} s outside the pass, {entry[row]} to {end[row]}",
        worst=outside_s,
    )
