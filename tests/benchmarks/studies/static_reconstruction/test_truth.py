"""Depth and heights compared with closed forms, names of runs, and selected frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from benchmarks.studies.static_reconstruction.jobs import Job, parse_job
from benchmarks.studies.static_reconstruction.truth.geometry import (
    by_distance,
    height_errors,
    nearby_road,
    relative_error,
)
from benchmarks.studies.static_reconstruction.truth.street import TrueView, camera_z, world_points
from benchmarks.studies.static_reconstruction.truth.trained import evenly_chosen
from mirror.errors import UsageError
from mirror.protocols.views.view import RenderView
from mirror.synth.model import Label
from tests.draws import draws

angles = st.floats(-0.4, 0.4)


def view_at(roll: float, pitch: float, yaw: float, height_m: float, origin_m: float = 0.0) -> RenderView:
    """A camera over a plane, looking east, with small rotations."""
    level = Rotation.from_matrix([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    x, y, z, w = (level * Rotation.from_euler("zxy", (roll, pitch, yaw))).as_quat().tolist()
    return RenderView(
        path="renders/a.png", group="training", scene_id="s", traversal_id="s.a.0", frame_index=0, camera="front_wide",
        timestamp_ns=0, light="day", weather="clear", model="pinhole", width_px=24, height_px=16, fx_px=15.0,
        fy_px=14.0, cx_px=11.3, cy_px=8.2, distortion=(),
        world_SE3_camera=(w, x, y, z, origin_m + 3.0, origin_m - 2.0, height_m),
    )  # fmt: skip


def plane(view: RenderView) -> tuple[np.ndarray, np.ndarray]:
    """Distances (H, W) to the plane z = 0 along rays, infinite above the horizon, and camera z, from matrices only."""
    u, v = np.meshgrid(np.arange(view.width_px) + 0.5, np.arange(view.height_px) + 0.5)
    slopes = np.stack([(u - view.cx_px) / view.fx_px, (v - view.cy_px) / view.fy_px, np.ones_like(u)], axis=-1)
    w, x, y, z = view.world_SE3_camera.rotation[0]
    down = slopes @ Rotation.from_quat([x, y, z, w]).as_matrix()[2]
    depth = np.where(down < -1e-3, view.world_SE3_camera.translation[0, 2] / np.maximum(-down, 1e-3), np.inf)
    return depth * np.linalg.norm(slopes, axis=-1), depth


@settings(max_examples=draws(40), deadline=None)
@given(angles, angles, angles, st.floats(0.5, 3.0), st.sampled_from((0.0, 1e5)))
def test_depth_of_a_plane(roll: float, pitch: float, yaw: float, height_m: float, origin_m: float) -> None:
    view = view_at(roll, pitch, yaw, height_m, origin_m)
    distance, depth = plane(view)
    found = camera_z(distance, view.lens)
    assert np.array_equal(np.isinf(found), np.isinf(depth))
    seen = np.isfinite(depth)
    np.testing.assert_allclose(found[seen], depth[seen], rtol=1e-12)
    points = world_points(np.where(seen, depth, 0.0), view)
    np.testing.assert_allclose(points[seen][:, 2], 0.0, atol=1e-9 * max(1.0, float(depth[seen].max(initial=1.0))))
    np.testing.assert_allclose(
        np.linalg.norm(points - view.pose.translation[0], axis=-1)[seen], distance[seen], rtol=1e-9, atol=1e-9
    )


@settings(max_examples=draws(40), deadline=None)
@given(st.floats(0.2, 5.0))
def test_heights_of_a_plane_whose_depth_is_scaled(factor: float) -> None:
    view = view_at(0.0, 0.0, 0.0, 1.5)
    _, depth = plane(view)
    seen = np.isfinite(depth)
    heights = world_points(np.where(seen, factor * depth, 0.0), view)[seen][:, 2]
    # A point of the plane at a multiple of its depth is lower by this multiple of the camera's height of 1.5 m.
    row = height_errors(heights)
    assert row["bias_m"] == pytest.approx(1.5 * (1.0 - factor), abs=1e-9)
    assert (row["median_m"], row["p90_m"]) == pytest.approx((abs(1.5 * (1.0 - factor)),) * 2, abs=1e-9)


def test_only_road_near_the_camera_is_measured() -> None:
    view = view_at(0.0, 0.0, 0.0, 1.5)
    distance, depth = plane(view)
    label = np.full(depth.shape, Label.ROAD, np.uint8)
    label[:, :4] = Label.PAVEMENT
    static = np.isfinite(depth)
    static[-1] = False
    found = nearby_road(TrueView(depth.astype(np.float32), label, static), view)
    np.testing.assert_array_equal(found, (label == Label.ROAD) & static & (distance <= 25.0))
    assert found.any() and not found.all()


def test_errors_by_distance() -> None:
    true = np.array([1.9, 2.0, 4.9, 5.0, 5.0, 5.0, 100.0])
    errors = np.array([9.0, 0.1, 0.3, 1.0, 2.0, 3.0, 9.0])
    near, far = by_distance(errors, true, (2.0, 5.0, 10.0))
    assert near == {"from_m": 2.0, "to_m": 5.0, "median": pytest.approx(0.2), "p90": pytest.approx(0.28), "pixels": 2}
    assert far["median"] == 2.0 and far["p90"] == pytest.approx(2.8) and far["pixels"] == 3
    (empty,) = by_distance(errors, true, (10.0, 20.0))
    assert np.isnan(empty["median"]) and np.isnan(empty["p90"]) and empty["pixels"] == 0


def test_missing_depth_has_a_relative_error_of_one() -> None:
    np.testing.assert_array_equal(
        relative_error(np.array([0.0, 2.0, 6.0]), np.array([4.0, 4.0, 4.0])), np.array([1.0, 0.5, 0.5])
    )


def test_no_ground_at_all() -> None:
    row = height_errors(np.empty(0))
    assert row["count"] == 0 and all(np.isnan(row[name]) for name in ("bias_m", "median_m", "p90_m"))


@settings(deadline=None)
@given(
    st.sampled_from(("ours", "mtgs_style-tuned", "1-traversals", "ours+rates0.5+sizes2")), st.integers(0, 99),
    st.integers(1, 400), st.integers(8, 4000),
)  # fmt: skip
def test_run_names_identify_their_jobs(entry: str, seed: int, quarters: int, width_px: int) -> None:
    job = Job(entry, "guangzhou-urban", seed, quarters / 4.0, width_px)
    assert parse_job(job.name) == job


def test_other_folders_are_not_runs() -> None:
    with pytest.raises(UsageError, match="ENTRY"):
        parse_job("ours.guangzhou-urban")


@settings(max_examples=draws(50), deadline=None)
@given(st.lists(st.integers(), unique=True, max_size=40), st.integers(2, 9))
def test_items_are_evenly_chosen(things: list[int], most: int) -> None:
    found = evenly_chosen(things, most)
    assert len(found) == min(len(things), most)
    places = [things.index(one) for one in found]
    assert places == sorted(places)
    if things:
        assert found[0] == things[0] and found[-1] == things[-1]
        gaps = np.diff(places)
        assert len(gaps) == 0 or gaps.max() - gaps.min() <= 1
