"""Writes the images of a drive, or references to them, with their exposure times, calibrations, masks and boxes."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa

from mirror.arrays import AnyArray
from mirror.schema.files import write_bytes, write_table
from mirror.schema.tables import BOXES
from mirror.synth.errors import Errors
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.on_demand.png import stored_png_length
from mirror.synth.on_demand.uri import ImageName
from mirror.synth.writing.boxes import boxes_in_view, least_px, make_box_rows
from mirror.synth.writing.schedule import ImageSchedule
from mirror.synth.writing.truth import TruthKind, TruthRequest, write_image_truth

_JPEG_QUALITY: Final = 90


@dataclass
class FrameImages:
    """The written images of one instant.

    Attributes:
        images: number of images.
        boxes: rows of the ``boxes`` table: road users that the images show.
        unseen: number of nearby road users that no image shows.
        truth_boxes: rows of the true boxes table.
    """

    images: int = 0
    boxes: pa.Table = field(default_factory=BOXES.schema.empty_table)
    unseen: int = 0
    truth_boxes: list[dict[str, Any]] = field(default_factory=list)


def write_images(
    folder: Path, drive: SynthDrive, schedule: ImageSchedule, kinds: Sequence[TruthKind], pool: ThreadPoolExecutor
) -> Iterator[FrameImages]:
    """Write all images of a drive and their boxes; yields once per instant."""
    for name in schedule.true_ns:
        (folder / "images" / name).mkdir(parents=True, exist_ok=True)
    drive.prepare()
    boxes = []
    for frame in pool.map(
        lambda number: _write_frame_images(folder, drive, schedule, kinds, number), range(len(schedule))
    ):
        boxes.append(frame.boxes)
        yield frame
    if drive.vehicle.kind.stagger_ns or drive.vehicle.readouts:
        _write_exposures(folder, drive, schedule)
    write_boxes(folder, pa.concat_tables([BOXES.schema.empty_table(), *boxes]))


def _write_frame_images(
    folder: Path, drive: SynthDrive, schedule: ImageSchedule, kinds: Sequence[TruthKind], number: int
) -> FrameImages:
    """Write the images of one instant."""
    frame, instant, made_ns = FrameImages(), None, -1
    road_users = drive.road_users
    visible_pixels = np.zeros(len(road_users), np.int64)
    for place, camera in enumerate(schedule.true_ns):
        true_ns, recorded_ns = int(schedule.true_ns[camera][number]), int(schedule.recorded_ns[camera][number])
        if instant is None or true_ns != made_ns:
            instant, made_ns = drive.at(true_ns), true_ns
        if place == 0:
            reference_ns, box_ns, placements = true_ns, recorded_ns, instant.placements
        if not schedule.kept[camera][number]:
            continue
        image = drive.render(camera, true_ns, instant)
        write_bytes(folder / "images" / camera / f"{recorded_ns}.jpg", encode_image(".jpg", image.bgr))
        frame.images += 1
        objects = image.view.object
        visible_pixels = np.maximum(visible_pixels, np.bincount(objects[objects >= 0], minlength=len(visible_pixels)))
        if kinds:
            request = TruthRequest(camera, true_ns, recorded_ns, schedule.following(camera, number))
            frame.truth_boxes += write_image_truth(folder, drive, kinds, request, instant, image)
    shown = [key for key in placements if visible_pixels[key] >= least_px(drive)]
    frame.unseen = len(placements) - len(shown)
    frame.boxes = make_box_rows(
        [road_users[key] for key in shown], [placements[key] for key in shown],
        drive.world_SE3_ego(np.array([reference_ns])), box_ns,
    )  # fmt: skip
    return frame


def _write_exposures(folder: Path, drive: SynthDrive, schedule: ImageSchedule) -> None:
    for name, stamps in schedule.recorded_ns.items():
        # from the start of the first line's exposure to the end of the last line's
        half = (drive.vehicle.kind.exposure_ns + drive.vehicle.shutter(name).readout_ns) // 2
        lines = [f"{stamp}.jpg,{stamp - half},{stamp + half}" for stamp in stamps[schedule.kept[name]].tolist()]
        text = "\n".join(["file,exposure_start_ns,exposure_end_ns", *lines, ""])
        write_bytes(folder / "images" / f"{name}.csv", text.encode())


def write_image_references(folder: Path, drive: SynthDrive, schedule: ImageSchedule, seed: int) -> FrameImages:
    """Write the URIs of all images of a drive, and the boxes in view of its cameras.

    Args:
        folder: folder of the recording.
        drive: drive of the recording.
        schedule: when its images were taken.
        seed: seed of the preset.
    """
    half = drive.vehicle.kind.exposure_ns // 2
    count = 0
    for name, camera in drive.vehicle.cameras.items():
        size = f"{stored_png_length(camera.width_px, camera.height_px)},{camera.width_px},{camera.height_px}"
        lines = ["uri,exposure_start_ns,exposure_end_ns,byte_length,width_px,height_px"]
        for number in np.flatnonzero(schedule.kept[name]).tolist():
            true_ns, recorded_ns = int(schedule.true_ns[name][number]), int(schedule.recorded_ns[name][number])
            uri = ImageName(drive.preset.name, seed, drive.drive_id, name, true_ns).uri()
            lines.append(f"{uri},{recorded_ns - half},{recorded_ns + half},{size}")
        count += len(lines) - 1
        write_bytes(folder / "images" / f"{name}.csv", "\n".join([*lines, ""]).encode())
    boxes = boxes_in_view(drive, schedule)
    write_boxes(folder, boxes)
    return FrameImages(count, boxes)


def write_boxes(folder: Path, boxes: pa.Table) -> None:
    """Write ``boxes.parquet``."""
    write_table(folder / "boxes.parquet", boxes.sort_by([(key, "ascending") for key in BOXES.sorted_by]), BOXES)


def write_cameras(folder: Path, drive: SynthDrive, schedule: ImageSchedule, errors: Errors) -> None:
    """Write the calibrations of both stages, and the ego masks."""
    for stage in ("factory", "online"):
        calibration = drive.vehicle.calibration(stage, errors, drive.seed, schedule.clocks)
        write_bytes(folder / "calibrations" / f"{stage}.json", json.dumps(calibration, indent=1).encode())
    for name, mask in drive.ego_masks.items():
        write_bytes(folder / "masks" / f"{name}.png", encode_image(".png", mask))


def encode_image(suffix: str, image: AnyArray) -> bytes:
    """Encode an image in the format of a file suffix: ``.jpg`` or ``.png``."""
    import cv2

    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY] if suffix == ".jpg" else []
    return bytes(cv2.imencode(suffix, image, options)[1])
