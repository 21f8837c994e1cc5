"""Edited vehicles of a synthetic street: exact where nothing is edited, and where they stand and cast shadows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mirror.arrays import Bool
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError
from mirror.geometry import matrix_from_quaternion
from mirror.protocols.document import Group, Protocol, load_protocol
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views.edits import shift_to_left
from mirror.protocols.views.plan import find_group, plan_views
from mirror.protocols.views.view import RenderView
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.fleet.drives import make_drive
from mirror.synth.hidden_truth import render_view
from mirror.synth.light.condition import Effects
from mirror.synth.model import Label
from mirror.synth.render.scene import Scene
from mirror.synth.road_users.edits import edit_road_users
from mirror.synth.truth.casting import cast_rays
from mirror.synth.writing.boxes import world_SE3_boxes
from mirror.synth.writing.images import encode_image
from mirror.traffic.placement.motion import StaticMotion

SHIFTS_M = {"0m": 0.0, "left-2m": 2.0}
SPLIT = "novel"


@pytest.fixture(scope="module")
def protocol() -> Protocol:
    """All vehicles of all traversals, by day and by night, moving and parked."""
    known = load_protocol("vehicle-translation")
    assert known.vehicles is not None
    return known.model_copy(
        update={
            "groups": tuple(
                Group(name=name, roles=("train", "held_out"), vehicle_shift_m=shift) for name, shift in SHIFTS_M.items()
            ),
            "frames": known.frames.model_copy(update={"every": 4}),
            "vehicles": known.vehicles.model_copy(update={"min_area_px": 150.0}),
        }
    )


@pytest.fixture(scope="module")
def views(tiny_dataset: Dataset, protocol: Protocol) -> tuple[RenderView, ...]:
    return plan_views(tiny_dataset, protocol, SPLIT).views


def drive_of(view: RenderView) -> SynthDrive:
    return make_drive("tiny", 0, view.traversal_id.split(".")[1])


def test_vehicles_that_stay_give_the_recorded_bytes(
    tiny_dataset: Dataset, protocol: Protocol, views: tuple[RenderView, ...]
) -> None:
    """Every edited vehicle is placed again, parked ones in a new static scene; all effects are as recorded."""
    truth = GroundTruth(tiny_dataset, protocol, {})
    kinds, light = set(), set()
    for view in [view for view in views if view.group == "0m"][::10]:
        drive = drive_of(view)
        motions = {user.track_id: user.motion for user in drive.road_users}
        kinds |= {isinstance(motions[edit.track_id], StaticMotion) for edit in view.edits}
        light.add(view.light)
        pixels = render_view(view, find_group(protocol, "0m"), "tiny", 0, drive.drive_id)
        _, image = truth.recorded_frame_and_image(view)
        assert encode_image(".jpg", pixels[..., ::-1]) == image.read(), view.path
    assert kinds == {True, False}
    assert light == {"day", "night"}


def test_shifted_placements_are_the_targets_of_the_plan(views: tuple[RenderView, ...]) -> None:
    """The placements of the street and the boxes of the plan are moved by different arithmetic."""
    users = drive_of(views[0]).road_users
    rolled = [user for user in users if abs(user.motion.at(3.0).roll_rad) > 1e-3]
    assert len(rolled) > 5
    for left_m in (-3.0, 1.5):
        shifted = edit_road_users(rolled, {user.track_id: left_m for user in rolled})
        here, there = (world_SE3_boxes(part, [user.motion.at(3.0) for user in part]) for part in (rolled, shifted))
        targets = shift_to_left(here, left_m)
        np.testing.assert_allclose(there.translation, targets.translation, atol=1e-12)
        np.testing.assert_allclose(there.rotation, targets.rotation, atol=1e-12)
    assert edit_road_users(users, {users[3].track_id: None}) == (*users[:3], *users[4:])
    with pytest.raises(DatasetError, match="no road user nobody"):
        edit_road_users(users, {"nobody": 1.0})


def test_a_moved_vehicle_is_seen_and_shades_where_rays_say(views: tuple[RenderView, ...]) -> None:
    """Single rays, in float64, decide which pixels show the moved vehicle and which ground lies in its shadow."""
    view = next(view for view in views if view.light == "day" and len(view.edits) > 1)
    drive = drive_of(view)
    stamp = np.array([view.timestamp_ns])
    time_s, ego = float(drive.seconds(stamp)[0]), drive.world_SE3_ego(stamp)
    pose, camera = drive.world_SE3_camera(view.camera, stamp), drive.vehicle.cameras[view.camera]
    origin, turn = pose.translation[0], matrix_from_quaternion(pose.rotation)[0]
    u, v = np.meshgrid(np.arange(camera.width_px) + 0.5, np.arange(camera.height_px) + 0.5)
    rays = camera.unproject(np.stack([u, v], axis=-1))
    sun = np.array(drive.stage.light.record["sun"])
    effects = replace(Effects.none(), sun_shadows=True, traffic=True)
    conditions = {
        "sun": replace(drive.condition, effects=effects),
        "no shadows": replace(drive.condition, effects=replace(effects, sun_shadows=False)),
    }
    checked = 0
    for track_id in [edit.track_id for edit in view.edits]:
        moved, removed = (edit_road_users(drive.road_users, {track_id: shift}) for shift in (2.0, None))
        images = {}
        for name, users, light in (
            ("moved", moved, "sun"),
            ("removed", removed, "sun"),
            ("unshaded", removed, "no shadows"),
        ):
            scene = Scene(drive.world, conditions[light], users, drive.ego_model, clock_s=drive.truth.clock_s)
            images[name] = scene.render(scene.at(time_s, ego), drive.lenses[view.camera], pose)
        number = next(place for place, user in enumerate(moved) if user.track_id == track_id)
        at = moved[number].motion.at(time_s)
        body = moved[number].body.model_at(at).transform(at.rotation, at.translation)
        hit = np.full(u.shape, np.inf)
        hit[rays.valid] = cast_rays(body, origin, rays.direction[rays.valid] @ turn.T)[0]
        behind = images["removed"].view.distance_m
        seen: Bool = hit < behind
        assert (seen == (images["moved"].view.object == number)).mean() > 0.999, track_id
        levels = {name: image.bgr.astype(np.float64).sum(axis=2) for name, image in images.items()}
        # Ground in the sun: darker where a ray to the sun meets the vehicle.
        ground = (images["removed"].view.label <= Label.TERRAIN) & ~seen & rays.valid & np.isfinite(behind)
        ground &= np.abs(levels["removed"] - levels["unshaded"]) < 6.0
        points = origin + behind[ground][:, None] * (rays.direction[ground] @ turn.T)
        shaded = np.array([cast_rays(body, point + 50.0 * sun, -sun[None])[0][0] < 50.0 for point in points], np.bool_)
        darker = (levels["moved"] < 0.75 * levels["removed"])[ground]
        if shaded.sum() > 40:
            checked += 1
            assert (shaded & darker).sum() / (shaded | darker).sum() > 0.85
    assert checked
