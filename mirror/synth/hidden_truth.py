"""Renders the hidden truth of a synthetic street: images from moved cameras, which only the organiser has."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, UsageError
from mirror.geometry.poses import Poses
from mirror.metrics.images.psnr import psnr
from mirror.protocols.png import encode_png
from mirror.protocols.truth.hidden import HIDDEN, make_hidden_document
from mirror.protocols.truth.raster import cached_raster
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views.plan import Plan, find_group
from mirror.protocols.views.view import RenderView
from mirror.schema.files import write_bytes, write_json
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.schema.render_folder import finish_render_folder, start_render_folder

if TYPE_CHECKING:
    from mirror.synth.fleet.drive import SynthDrive
    from mirror.synth.render.scene import Instant
    from mirror.synth.writing.schedule import ImageSchedule

_LEAST_DB: Final = 28.0
"""Least PSNR between a recorded image and the same image rendered again. The difference is the loss of JPEG, and 35 dB
and more are usual; an image of another street has 20 dB at most."""


def write_hidden_truth(
    dataset: Dataset,
    plan: Plan,
    preset: str,
    seed: int,
    out: Path,
    advance: Callable[[int], None] = lambda _: None,
) -> int:
    """Render the true images of a plan's views, in the layout of a submission.

    Each image is rendered from its true pose, shifted as the view's group states; the recording vehicle moves with
    its cameras. The image is then resampled to the view's raster with the dataset's calibration, as recorded images
    are, so both contain the same calibration error. Before that, one recorded image of each traversal is rendered
    again and compared, which detects a wrong preset or seed. ``hidden.json`` describes the images and is written last.

    Args:
        dataset: dataset of recordings that ``mirror synth`` wrote.
        plan: the views; their groups move cameras and edit nothing else.
        preset: preset of the recordings.
        seed: seed of the recordings.
        out: a new or an empty folder, or one with an unfinished run of the same arguments, the images of which are
            kept.
        advance: receives the number of finished views.

    Returns:
        The number of images.

    Raises:
        UsageError: a group edits vehicles, the folder holds other files, or the preset or a drive does not exist.
        DatasetError: a recorded image does not match the preset and seed, or the folder cannot be written.
    """
    if any(group.vehicle_shift_m is not None or group.without_vehicles for group in plan.protocol.groups):
        raise UsageError(f"protocol {plan.protocol.name} edits vehicles", expected="one that only moves cameras")
    require_output_folder(out, FolderKind.SUBMISSION)
    table = dataset.table("traversals", ["traversal_id", "drive_id"]).to_pylist()
    drives = {row["traversal_id"]: row["drive_id"] for row in table}
    truth = GroundTruth(dataset, plan.protocol, plan.layers)
    # Views of the same time use the same cached instant.
    ordered = sorted(plan.views, key=lambda planned: (planned.traversal_id, planned.timestamp_ns, planned.group))
    for view in {planned.traversal_id: planned for planned in reversed(ordered)}.values():
        _require_recorded(view, truth, preset, seed, drives[view.traversal_id])
    start_render_folder(out, ("hidden truth", plan.hash, preset, str(seed)), last=HIDDEN)
    missing = [view for view in ordered if not (out / view.path).is_file()]
    advance(len(ordered) - len(missing))
    for view in missing:
        _, image = truth.recorded_frame_and_image(view)
        shift_m = find_group(plan.protocol, view.group).ego_shift_m
        recorded = render_shifted(view, shift_m, preset, seed, drives[view.traversal_id])
        pixels = cached_raster(image.camera_model, plan.protocol.pixels).to_final(recorded)
        write_bytes(out / view.path, encode_png(pixels))
        advance(1)
    write_json(out / HIDDEN, make_hidden_document(plan, preset, seed))
    finish_render_folder(out)
    return len(plan.views)


def _require_recorded(view: RenderView, truth: GroundTruth, preset: str, seed: int, drive_id: str) -> None:
    """Check that the image of a view, rendered at its true pose, equals the recorded image."""
    recorded = truth.recorded_frame_and_image(view)[1].decode()
    rendered = render_shifted(view, 0.0, preset, seed, drive_id)
    psnr_db = float(psnr(rendered, recorded)) if rendered.shape == recorded.shape else None
    if psnr_db is None or psnr_db < _LEAST_DB:
        sizes = " and ".join(
            f"{image_array.shape[1]} x {image_array.shape[0]} px" for image_array in (rendered, recorded)
        )
        raise DatasetError(
            f"drive {drive_id} of preset {preset}, seed {seed}, is not what was recorded "
            + (f"({sizes})" if psnr_db is None else f"({psnr_db:.1f} dB)"),
            place=f"camera {view.camera} at {view.timestamp_ns}",
            expected="the preset and seed that the recordings were made with, and their effects and errors",
        )


def render_shifted(view: RenderView, shift_m: float, preset: str, seed: int, drive_id: str) -> UInt8:
    """Render the RGB image (H, W, 3) of a view with the vehicle shifted to its left by ``shift_m``."""
    drive, schedule = _drive(preset, seed, drive_id)
    stamps = schedule.recorded_ns.get(view.camera, np.empty(0, np.int64))
    at = np.flatnonzero(stamps == view.timestamp_ns)
    if not len(at):
        raise DatasetError(
            f"drive {drive_id} of preset {preset}, seed {seed}, has no image at {view.timestamp_ns}",
            place=f"camera {view.camera}",
            expected="the preset and seed that the recordings were made with",
        )
    true_ns = int(schedule.true_ns[view.camera][at[0]])
    aside = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[0.0, shift_m, 0.0]]))
    instant = _instant(preset, seed, drive_id, true_ns, shift_m)
    world_SE3_ego = drive.world_SE3_ego(np.array([true_ns])) @ aside
    rendered = drive.stage.render(
        instant,
        drive.lenses[view.camera],
        world_SE3_ego @ drive.vehicle.ego_SE3_camera[view.camera],
        response=drive.camera_responses[view.camera],
        seed=true_ns % (1 << 31),
        drops=drive.drops.get(view.camera),
    )
    return np.ascontiguousarray(rendered.bgr[..., ::-1])


@lru_cache(2)
def _drive(preset: str, seed: int, drive_id: str) -> tuple[SynthDrive, ImageSchedule]:
    from mirror.synth.fleet.drives import make_drive
    from mirror.synth.writing.schedule import schedule_images

    drive = make_drive(preset, seed, drive_id)
    drive.prepare()
    return drive, schedule_images(drive, drive.preset.errors)


@lru_cache(8)
def _instant(preset: str, seed: int, drive_id: str, true_ns: int, shift_m: float) -> Instant:
    """The world at a time, with the recording vehicle shifted to its left by ``shift_m``."""
    drive, _ = _drive(preset, seed, drive_id)
    stamps = np.array([true_ns])
    aside = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[0.0, shift_m, 0.0]]))
    return drive.stage.at(float(drive.seconds(stamps)[0]), drive.world_SE3_ego(stamps) @ aside)
