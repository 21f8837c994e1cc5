"""Pictures of a drive, written or referred to, and what belongs to them: exposures, calibrations, masks, boxes."""

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
from mirror.synth.on_demand.png import stored_length
from mirror.synth.on_demand.uri import PictureName
from mirror.synth.writing.boxes import box_rows, boxes_in_view, least_px
from mirror.synth.writing.shots import Shots
from mirror.synth.writing.truth import TruthKind, TruthRequest, write_picture_truth

_JPEG_QUALITY: Final = 90


@dataclass
class Frame:
    """What writing the pictures of one instant came to.

    Attributes:
        pictures: written.
        boxes: of what they show.
        unseen: road users nearby that they do not show.
        truth_boxes: rows of the truth.
    """

    pictures: int = 0
    boxes: pa.Table = field(default_factory=BOXES.schema.empty_table)
    unseen: int = 0
    truth_boxes: list[dict[str, Any]] = field(default_factory=list)


def write_frames(
    folder: Path, drive: SynthDrive, shots: Shots, kinds: Sequence[TruthKind], pool: ThreadPoolExecutor
) -> Iterator[Frame]:
    """Write all pictures of a drive and their boxes, instant by instant."""
    for name in shots.true_ns:
        (folder / "images" / name).mkdir(parents=True, exist_ok=True)
    drive.prepare()
    boxes = []
    for frame in pool.map(lambda number: _write_frame(folder, drive, shots, kinds, number), range(len(shots))):
        boxes.append(frame.boxes)
        yield frame
    if drive.vehicle.kind.stagger_ns:
        _write_exposures(folder, drive, shots)
    write_boxes(folder, pa.concat_tables([BOXES.schema.empty_table(), *boxes]))


def _write_frame(folder: Path, drive: SynthDrive, shots: Shots, kinds: Sequence[TruthKind], number: int) -> Frame:
    """Write the pictures of one instant."""
    frame, instant, made_ns = Frame(), None, -1
    users = drive.users
    seen = np.zeros(len(users), np.int64)
    for place, camera in enumerate(shots.true_ns):
        true_ns, recorded_ns = int(shots.true_ns[camera][number]), int(shots.recorded_ns[camera][number])
        if instant is None or true_ns != made_ns:
            instant, made_ns = drive.at(true_ns), true_ns
        if place == 0:
            reference_ns, box_ns, placements = true_ns, recorded_ns, instant.placements
        if not shots.kept[camera][number]:
            continue
        picture = drive.picture(camera, true_ns, instant)
        write_bytes(folder / "images" / camera / f"{recorded_ns}.jpg", encoded(".jpg", picture.bgr))
        frame.pictures += 1
        objects = picture.view.object
        seen = np.maximum(seen, np.bincount(objects[objects >= 0], minlength=len(seen)))
        if kinds:
            asked = TruthRequest(camera, true_ns, recorded_ns, shots.following(camera, number))
            frame.truth_boxes += write_picture_truth(folder, drive, kinds, asked, instant, picture)
    shown = [key for key in placements if seen[key] >= least_px(drive)]
    frame.unseen = len(placements) - len(shown)
    frame.boxes = box_rows(
        [users[key] for key in shown], [placements[key] for key in shown],
        drive.world_SE3_ego(np.array([reference_ns])), box_ns,
    )  # fmt: skip
    return frame


def _write_exposures(folder: Path, drive: SynthDrive, shots: Shots) -> None:
    half = drive.vehicle.kind.exposure_ns // 2
    for name, stamps in shots.recorded_ns.items():
        lines = [f"{stamp}.jpg,{stamp - half},{stamp + half}" for stamp in stamps[shots.kept[name]].tolist()]
        text = "\n".join(["file,exposure_start_ns,exposure_end_ns", *lines, ""])
        write_bytes(folder / "images" / f"{name}.csv", text.encode())


def refer_to_pictures(folder: Path, drive: SynthDrive, shots: Shots, seed: int) -> Frame:
    """List all pictures of a drive by their uris, and write the boxes of what they may show.

    Args:
        folder: of the recording.
        drive: that it is of.
        shots: its pictures.
        seed: of the preset.
    """
    half = drive.vehicle.kind.exposure_ns // 2
    count = 0
    for name, camera in drive.vehicle.cameras.items():
        size = f"{stored_length(camera.width_px, camera.height_px)},{camera.width_px},{camera.height_px}"
        lines = ["uri,exposure_start_ns,exposure_end_ns,byte_length,width_px,height_px"]
        for number in np.flatnonzero(shots.kept[name]).tolist():
            true_ns, recorded_ns = int(shots.true_ns[name][number]), int(shots.recorded_ns[name][number])
            uri = PictureName(drive.preset.name, seed, drive.drive_id, name, true_ns).uri()
            lines.append(f"{uri},{recorded_ns - half},{recorded_ns + half},{size}")
        count += len(lines) - 1
        write_bytes(folder / "images" / f"{name}.csv", "\n".join([*lines, ""]).encode())
    boxes = boxes_in_view(drive, shots)
    write_boxes(folder, boxes)
    return Frame(count, boxes)


def write_boxes(folder: Path, boxes: pa.Table) -> None:
    """Write ``boxes.parquet``."""
    write_table(folder / "boxes.parquet", boxes.sort_by([(key, "ascending") for key in BOXES.sorted_by]), BOXES)


def write_cameras(folder: Path, drive: SynthDrive, shots: Shots, errors: Errors) -> None:
    """Write calibrations of both stages, and masks."""
    for stage in ("factory", "online"):
        calibration = drive.vehicle.calibration(stage, errors, drive.seed, shots.clocks)
        write_bytes(folder / "calibrations" / f"{stage}.json", json.dumps(calibration, indent=1).encode())
    for name, mask in drive.own_masks.items():
        write_bytes(folder / "masks" / f"{name}.png", encoded(".png", mask))


def encoded(suffix: str, picture: AnyArray) -> bytes:
    """A picture as a file."""
    import cv2

    options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY] if suffix == ".jpg" else []
    return bytes(cv2.imencode(suffix, picture, options)[1])
