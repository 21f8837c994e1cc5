"""Renders the hidden truth of a synthetic street: moved cameras and edited vehicles, which only the organiser has."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from mirror.arrays import UInt8
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError
from mirror.geometry.poses import Poses
from mirror.metrics.images.psnr import psnr
from mirror.protocols.document import Group
from mirror.protocols.png import encode_png
from mirror.protocols.truth.hidden import HIDDEN, make_hidden_document
from mirror.protocols.truth.raster import cached_raster
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views.plan import Plan, find_group
from mirror.protocols.views.view import RenderView
from mirror.schema.files import write_bytes, write_json
from mirror.schema.folders import FolderKind, require_output_folder
from mirror.schema.render_folder import finish_render_folder, start_render_folder
from mirror.synth.seeds import derive_hash_seed, is_secret_seed, name_seed

if TYPE_CHECKING:
    from mirror.synth.fleet.drive import SynthDrive
    from mirror.synth.render.scene import Instant, Scene
    from mirror.synth.writing.schedule import ImageSchedule

_LEAST_DB: Final = 28.0
"""Least PSNR between a recorded image and the same image rendered again. The difference is the loss of JPEG, and 35 dB
and more are usual; an image of another street has 20 dB at most."""


_Edits = tuple[tuple[str, float | None], ...]
"""Edited road users: track id and shift to the left in metres; None: removed."""


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
    its cameras. Edited vehicles stand where the group puts them, or are not there, with their shadows, lights and
    reflections; all else, the noise and the blur of an unmoved camera included, is as it was recorded. The image is
    then resampled to the view's raster with the dataset's calibration, as recorded images are, so both contain the same
    calibration error. Before that, one recorded image of each traversal is rendered again and compared, which detects a
    wrong preset or seed. ``hidden.json`` describes the images and is written last.

    Args:
        dataset: dataset of recordings that ``mirror synth`` wrote.
        plan: the views.
        preset: preset of the recordings.
        seed: seed of the recordings, public or secret; a secret one is not written.
        out: a new or an empty folder, or one with an unfinished run of the same arguments, the images of which are
            kept.
        advance: receives the number of finished views.

    Returns:
        The number of images.

    Raises:
        UsageError: the folder holds other files, or the preset or a drive does not exist.
        DatasetError: a recorded image does not match the preset and seed, an edited box is not of a road user of the
            street, or the folder cannot be written.
    """
    require_output_folder(out, FolderKind.SUBMISSION)
    table = dataset.table("traversals", ["traversal_id", "drive_id"]).to_pylist()
    drives = {row["traversal_id"]: row["drive_id"] for row in table}
    truth = GroundTruth(dataset, plan.protocol, plan.layers)
    # The cameras of a frame use the same cached scene and instant.
    ordered = sorted(plan.views, key=lambda planned: (planned.traversal_id, planned.frame_index, planned.group))
    for view in {planned.traversal_id: planned for planned in reversed(ordered)}.values():
        _require_recorded(view, truth, preset, seed, drives[view.traversal_id])
    start_render_folder(out, ("hidden truth", plan.hash, preset, str(seed)), last=HIDDEN)
    missing = [view for view in ordered if not (out / view.path).is_file()]
    advance(len(ordered) - len(missing))
    for view in missing:
        _, image = truth.recorded_frame_and_image(view)
        group = find_group(plan.protocol, view.group)
        recorded = render_view(view, group, preset, seed, drives[view.traversal_id])
        pixels = cached_raster(image.camera_model, plan.protocol.pixels).to_final(recorded)
        write_bytes(out / view.path, encode_png(pixels))
        advance(1)
    write_json(out / HIDDEN, make_hidden_document(plan, preset, None if is_secret_seed(seed) else seed))
    finish_render_folder(out)
    return len(plan.views)


def _require_recorded(view: RenderView, truth: GroundTruth, preset: str, seed: int, drive_id: str) -> None:
    """Check that the image of a view, rendered as it was recorded, equals the recorded image."""
    recorded = truth.recorded_frame_and_image(view)[1].decode()
    rendered = render_view(view, None, preset, seed, drive_id)
    psnr_db = float(psnr(rendered, recorded)) if rendered.shape == recorded.shape else None
    if psnr_db is None or psnr_db < _LEAST_DB:
        sizes = " and ".join(
            f"{image_array.shape[1]} x {image_array.shape[0]} px" for image_array in (rendered, recorded)
        )
        raise DatasetError(
            f"drive {drive_id} of preset {preset}, {name_seed(seed)}, is not what was recorded "
            + (f"({sizes})" if psnr_db is None else f"({psnr_db:.1f} dB)"),
            place=f"camera {view.camera} at {view.timestamp_ns}",
            expected="the preset and seed that the recordings were made with, and their effects and errors",
        )


def render_view(view: RenderView, group: Group | None, preset: str, seed: int, drive_id: str) -> UInt8:
    """Render the RGB image (H, W, 3) of a view as a group moves its cameras and vehicles, or as it was recorded."""
    drive, schedule = _drive(preset, seed, drive_id)
    stamps = schedule.recorded_ns.get(view.camera, np.empty(0, np.int64))
    at = np.flatnonzero(stamps == view.timestamp_ns)
    if not len(at):
        raise DatasetError(
            f"drive {drive_id} of preset {preset}, {name_seed(seed)}, has no image at {view.timestamp_ns}",
            place=f"camera {view.camera}",
            expected="the preset and seed that the recordings were made with",
        )
    true_ns = int(schedule.true_ns[view.camera][at[0]])
    shift_m = 0.0 if group is None else group.ego_shift_m
    edits = () if group is None else tuple((edit.track_id, group.vehicle_shift_m) for edit in view.edits)
    instant = _instant(preset, seed, drive_id, true_ns, shift_m, edits)
    # Other noise than the recorded image has: who copies that image has not seen the noise of the truth either.
    noise_seed = derive_hash_seed(f"shifted {view.camera}", drive.seed, true_ns, public=true_ns % (1 << 31))
    if shift_m == 0.0:
        is_recorded = all(left_m == 0.0 for _, left_m in edits)
        rendered = drive.render(view.camera, true_ns, instant, noise_seed=None if is_recorded else noise_seed)
    else:
        world_SE3_ego = drive.world_SE3_ego(np.array([true_ns])) @ _aside(shift_m)
        rendered = drive.stage.render(
            instant,
            drive.lenses[view.camera],
            world_SE3_ego @ drive.vehicle.ego_SE3_camera[view.camera],
            response=drive.camera_responses[view.camera],
            seed=noise_seed,
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


@lru_cache(2)
def _edited_scene(preset: str, seed: int, drive_id: str, edits: _Edits) -> Scene:
    """The scene of a drive with edited road users."""
    from mirror.synth.render.scene import Scene
    from mirror.synth.road_users.edits import edit_road_users

    drive, _ = _drive(preset, seed, drive_id)
    road_users = edit_road_users(drive.road_users, dict(edits))
    return Scene(drive.world, drive.condition, road_users, drive.ego_model, clock_s=drive.truth.clock_s)


@lru_cache(8)
def _instant(preset: str, seed: int, drive_id: str, true_ns: int, shift_m: float, edits: _Edits) -> Instant:
    """The world at a time, with edited road users, and the recording vehicle shifted to its left by ``shift_m``."""
    drive, _ = _drive(preset, seed, drive_id)
    stage = _edited_scene(preset, seed, drive_id, edits) if edits else drive.stage
    stamps = np.array([true_ns])
    return stage.at(float(drive.seconds(stamps)[0]), drive.world_SE3_ego(stamps) @ _aside(shift_m))


def _aside(shift_m: float) -> Poses:
    """A shift to the left in the vehicle's own frame."""
    return Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[0.0, shift_m, 0.0]]))
