"""The views of a plan: frames, lenses, poses and edits."""

from __future__ import annotations

import json

import numpy as np
import pytest
from pydantic import ValidationError

from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError
from mirror.geometry.cameras import Camera, undistorted
from mirror.geometry.poses import Poses, to_pose_numbers
from mirror.geometry.quaternions import matrix_from_quaternion
from mirror.protocols.document import Frames, Pixels, load_protocol
from mirror.protocols.truth.raster import Raster
from mirror.protocols.views import plan_views
from mirror.protocols.views.final_camera import final_camera
from mirror.protocols.views.plan import render_path, select_frames
from mirror.protocols.views.view import RenderView, to_pose
from tests.evaluation.submissions import SPLIT, small

LENSES = [
    Camera("pinhole", 160, 90, 100.0, 100.0, 80.0, 45.0),
    Camera("brown_conrady", 160, 90, 90.0, 91.0, 78.0, 46.0, (-0.2, 0.05, 0.001, -0.002, 0.0)),
    Camera("kannala_brandt", 160, 90, 70.0, 70.0, 80.0, 45.0, (0.02, -0.01, 0.0, 0.0)),
    Camera("f_theta", 160, 100, 1.0, 1.0, 80.0, 50.0, (0.0, 75.0, 0.0, -3.0)),
]


@pytest.mark.parametrize(
    ("count", "first", "every", "last", "chosen"),
    [
        (11, 0, 5, True, [0, 5, 10]),
        (12, 0, 5, True, [0, 5, 10, 11]),
        (12, 0, 5, False, [0, 5, 10]),
        (1, 0, 5, True, [0]),
        (0, 0, 5, True, []),
        (3, 1, 2, False, [1]),
        (29, 7, 8, False, [7, 15, 23]),
        (1, 1, 2, False, []),
        (1, 1, 2, True, [0]),
    ],
)
def test_every_nth_frame_and_the_last(count: int, first: int, every: int, last: bool, chosen: list[int]) -> None:
    assert select_frames(count, Frames(first=first, every=every, last=last)) == chosen


def test_default_first_frame_keeps_the_hash() -> None:
    protocol = load_protocol("static-reconstruction")
    later = protocol.model_copy(update={"frames": protocol.frames.model_copy(update={"first": 1})})
    assert "first" not in protocol.model_dump(mode="json")["frames"]
    assert later.hash != protocol.hash


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
def test_undistorted_raster_holds_the_lens_s_field_of_view(lens: Camera) -> None:
    flat = undistorted(lens, 70.0)
    assert (flat.model, flat.width_px, flat.height_px) == ("pinhole", lens.width_px, lens.height_px)
    u, v = np.meshgrid(np.arange(lens.width_px) + 0.5, np.arange(lens.height_px) + 0.5)
    rays = lens.unproject(np.stack([u, v], axis=-1).reshape(-1, 2))
    wide = np.degrees(np.arccos(rays.direction[:, 2]))
    seen = rays.valid & (wide < 69.9)
    assert flat.project(rays.direction[seen]).valid.all()
    # The raster is not larger: the field of view reaches all four sides.
    uv = flat.project(rays.direction[seen]).uv_px
    assert (uv.min(axis=0) < 3.0).all()
    assert (uv.max(axis=0) > np.array([flat.width_px, flat.height_px]) - 3.0).all()


@pytest.mark.parametrize(("cx_px", "cy_px"), [(-12.0, -30.0), (-30.0, -12.0), (-30.0, 130.0), (170.0, -30.0)])
def test_raster_of_an_off_axis_lens_is_exact_to_half_a_pixel(cx_px: float, cy_px: float) -> None:
    """The axis is outside a corner of the image, and the circle of the widest angle crosses two edges."""
    lens = Camera("kannala_brandt", 160, 120, 60.0, 60.0, cx_px, cy_px, (0.02, -0.01, 0.0, 0.0))
    flat = undistorted(lens, 60.0)
    u, v = np.meshgrid(np.linspace(0, 160, 1601), np.linspace(0, 120, 1201))
    rays = lens.unproject(np.stack([u, v], axis=-1).reshape(-1, 2))
    seen = rays.direction[rays.valid & (rays.direction[:, 2] >= np.cos(np.radians(60.0)))]
    uv = flat.project(seen).uv_px
    assert np.abs(uv.min(axis=0)).max() < 0.5
    assert np.abs(uv.max(axis=0) - (160, 120)).max() < 0.5


def test_raster_is_scaled_down_and_never_up() -> None:
    pixels = Pixels(space="raw", max_width_px=100)
    small_one = final_camera(LENSES[1], pixels)
    assert (small_one.width_px, small_one.height_px) == (100, 56)
    assert small_one.fx_px == pytest.approx(90.0 * 100 / 160)
    assert final_camera(LENSES[1], Pixels(space="raw", max_width_px=200)) == LENSES[1]


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.model)
@pytest.mark.parametrize("width", [160, 67])
def test_images_and_masks_are_resampled_through_the_lens(lens: Camera, width: int) -> None:
    raster = Raster(lens, Pixels(space="undistorted", max_width_px=width))
    # Red and green of the image encode the slopes of its rays: any lens must show the same slopes.
    u, v = np.meshgrid(np.arange(lens.width_px) + 0.5, np.arange(lens.height_px) + 0.5)
    rays = lens.unproject(np.stack([u, v], axis=-1)).direction
    slopes = rays[..., :2] / rays[..., 2:]
    levels = np.zeros((lens.height_px, lens.width_px, 3), np.uint8)
    levels[..., :2] = np.clip(np.round(128 + 40 * np.nan_to_num(slopes)), 0, 255)
    shown = raster.to_final(levels)
    final = raster.final
    assert shown.shape == (final.height_px, final.width_px, 3)
    true = final.rays().direction
    wanted = 128 + 40 * true[..., :2] / true[..., 2:]
    inside = ~raster.outside_lens & (np.abs(wanted - 128) < 90).all(axis=-1)
    assert inside.mean() > 0.5
    assert np.abs(shown[..., :2] - wanted)[inside].max() < 3.0
    # A masked block excludes every pixel with a ray in the block.
    mask = np.zeros((lens.height_px, lens.width_px), np.bool_)
    mask[30:50, 60:100] = True
    excluded = raster.exclude(mask)
    back = lens.project(true).uv_px
    within = (back[..., 0] > 60.6) & (back[..., 0] < 99.4) & (back[..., 1] > 30.6) & (back[..., 1] < 49.4)
    assert within.any()
    assert excluded[within].all()
    assert excluded.mean() < 0.5


def test_plan_agrees_with_the_tables(tiny_dataset: Dataset) -> None:
    protocol = small(every=4, width=100)
    plan = plan_views(tiny_dataset, protocol, SPLIT)
    held_out = tiny_dataset.where(split=SPLIT, role="held_out")
    rows = held_out.table("images", ["camera", "frame_index", "timestamp_ns"]).to_pylist()
    wanted = {
        (row["camera"], row["timestamp_ns"])
        for row in rows
        if row["frame_index"] is not None
        and row["frame_index"] % 4 == 0
        and row["camera"] in ("front_wide", "front_left")
    }
    assert {(view.camera, view.timestamp_ns) for view in plan.views} == wanted
    assert len({view.path for view in plan.views}) == len(plan.views)
    assert plan.hash == plan_views(tiny_dataset, protocol, SPLIT).hash
    assert plan.hash != plan_views(tiny_dataset, small(every=5, width=100), SPLIT).hash


def test_shifted_cameras_move_sideways(tiny_dataset: Dataset) -> None:
    groups = "".join(
        f'[[groups]]\nname = "{name}"\nroles = ["train"]\nego_shift_m = {shift}\n'
        for name, shift in (("here", 0.0), ("left-2m", 2.0))
    )
    plan = plan_views(tiny_dataset, small(groups=groups, task="lane-shift"), SPLIT)
    here = {view.path.replace("/here/", "/left-2m/"): view for view in plan.views if view.group == "here"}
    moved = [view for view in plan.views if view.group == "left-2m"]
    assert len(here) == len(moved) > 0
    for view in moved:
        other = here[view.path]
        frame = next(
            item
            for item in tiny_dataset.where(traversal=view.traversal_id).frames()
            if item.frame_index == view.frame_index
        )
        step = view.pose.translation[0] - other.pose.translation[0]
        left = matrix_from_quaternion(frame.world_SE3_ego.rotation)[0][:, 1]
        assert np.linalg.norm(step) == pytest.approx(2.0, abs=1e-9)
        assert step @ left == pytest.approx(2.0, abs=2e-3)
        np.testing.assert_allclose(view.pose.rotation, other.pose.rotation, atol=1e-12)


def test_edits_move_boxes_along_their_lateral_axis(tiny_dataset: Dataset) -> None:
    plan = plan_views(tiny_dataset, load_protocol("editing-accuracy"), SPLIT)
    groups = {view.group for view in plan.views}
    assert "background" in groups
    counts = {group: sum(view.group == group for view in plan.views) for group in groups}
    assert len(set(counts.values())) == 1
    for view in plan.views:
        (edit,) = view.edits
        if view.group == "background":
            assert edit.world_SE3_target is None
            continue
        assert edit.world_SE3_target is not None
        box, target = to_pose(edit.world_SE3_box), to_pose(edit.world_SE3_target)
        left = matrix_from_quaternion(box.rotation)[0][:, 1]
        wanted = {"right-2m": -2, "right-1m": -1, "0m": 0, "left-1m": 1, "left-2m": 2}[view.group]
        np.testing.assert_allclose(target.translation[0] - box.translation[0], wanted * left, atol=1e-9)


def test_impossible_plans_are_refused(tiny_dataset: Dataset) -> None:
    with pytest.raises(DatasetError, match=f"no such split; expected one of .*{SPLIT}"):
        plan_views(tiny_dataset, small(), "none")
    with pytest.raises(DatasetError, match="requests no image"):
        plan_views(tiny_dataset, small(groups='[[groups]]\nname = "a"\nroles = ["val"]\n'), SPLIT)
    with pytest.raises(DatasetError, match="cannot be a folder"):
        render_path("novel", "a.b.1", "../up", 1)


def test_poses_of_views_are_the_type_of_all_poses_and_numbers_in_files(tiny_dataset: Dataset) -> None:
    view = plan_views(tiny_dataset, load_protocol("static-reconstruction"), "novel").views[0]
    assert isinstance(view.world_SE3_camera, Poses) and view.pose is view.world_SE3_camera
    numbers = json.loads(view.model_dump_json())["world_SE3_camera"]
    assert numbers == list(to_pose_numbers(view.world_SE3_camera)) and len(numbers) == 7
    again = RenderView.model_validate_json(view.model_dump_json())
    assert again == view and hash(again) == hash(view) and again.model_dump_json() == view.model_dump_json()
    moved = view.model_copy(update={"world_SE3_camera": view.pose @ Poses([[1.0, 0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])})
    assert moved != view
    # Code of an earlier version gives the seven numbers.
    assert moved.model_copy(update={"world_SE3_camera": tuple(numbers)}) == view == RenderView(**view.model_dump())
    assert (to_pose(view.world_SE3_camera).matrix() == view.pose.matrix()).all()
    for wrong in (numbers[:6], [0.0] * 7, ["1"] * 7, view.pose[[0, 0]], "x", [float("nan")] * 7):
        with pytest.raises(ValidationError, match="world_SE3_camera"):
            RenderView(**{**view.model_dump(), "world_SE3_camera": wrong})
