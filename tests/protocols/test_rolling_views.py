"""Views of rolling shutters: times of final rasters, boxes where the rows see them, and the rasterizer's arguments."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hybridworldsim.trainable.viewpoint import to_viewpoint
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera, undistorted
from mirror.geometry.rolling_shutter import RollingShutter, project_rolling
from mirror.protocols.document import Pixels
from mirror.protocols.views.rolling import fit_line_times, rolling_hull_points
from mirror.protocols.views.view import RenderView, ViewShutter
from mirror.schema.hashing import hash_document

PINHOLE = Camera("pinhole", 640, 360, 400.0, 400.0, 320.0, 180.0)
BENT = Camera("brown_conrady", 640, 360, 400.0, 400.0, 320.0, 180.0, (-0.12, 0.01, 0.0003, -0.0002, 0.0))
READOUT_NS = 30_000_000


def at(x: float, yaw: float = 0.0) -> Poses:
    return Poses(np.array([[np.cos(yaw / 2), 0.0, np.sin(yaw / 2), 0.0]]), np.array([[x, 0.0, 0.0]]))


def view(shutter: ViewShutter | None) -> RenderView:
    return RenderView(
        path="renders/a/t/front/1.png", group="a", scene_id="s", traversal_id="t", frame_index=0, camera="front",
        timestamp_ns=1, light="day", weather="clear", **PINHOLE.to_row(), world_SE3_camera=at(0.0), shutter=shutter,
    )  # fmt: skip


def moving(direction: str = "top_to_bottom") -> ViewShutter:
    return ViewShutter(
        direction=direction, first_ns=-0.5 * READOUT_NS, last_ns=0.5 * READOUT_NS, world_SE3_first=at(-0.2),
        world_SE3_last=at(0.2, 0.01),
    )  # fmt: skip


def test_a_scaled_raster_has_the_times_of_the_recorded_rows() -> None:
    shutter = RollingShutter("bottom_to_top", READOUT_NS, 640, 360)
    same = fit_line_times(PINHOLE, shutter, PINHOLE)
    assert same.first_ns == pytest.approx(-0.5 * READOUT_NS)
    assert same.last_ns == pytest.approx(0.5 * READOUT_NS)
    assert same.residual_ns < 1.0
    half = fit_line_times(PINHOLE, shutter, PINHOLE.resized(320, 180))
    assert half.last_ns == pytest.approx(shutter.resized(320, 180).readout_ns / 2, abs=1.0)
    assert half.residual_ns < 1.0


def test_an_undistorted_row_is_nearly_a_recorded_one() -> None:
    shutter = RollingShutter("top_to_bottom", READOUT_NS, 640, 360)
    times = fit_line_times(BENT, shutter, undistorted(BENT))
    assert 0.9 * READOUT_NS < times.last_ns - times.first_ns < 1.3 * READOUT_NS
    assert 0.0 < times.residual_ns < 0.08 * READOUT_NS


@pytest.mark.parametrize("direction", ["top_to_bottom", "right_to_left"])
def test_points_are_seen_at_the_time_of_their_line(direction: str) -> None:
    shutter = RollingShutter(direction, READOUT_NS, 640, 360)  # type: ignore[arg-type]
    points = np.array([[0.5, -1.0, 6.0], [-1.0, 0.8, 4.0], [0.0, 0.0, 9.0]])
    velocity = np.array([15.0, 0.5, -8.0])
    seen, valid, times = project_rolling(
        PINHOLE, shutter, 3, lambda offsets: points - 1e-9 * offsets[:, None] * velocity
    )
    assert valid.all()
    np.testing.assert_allclose(shutter.offsets_ns(seen), times, atol=1e-2)
    again = PINHOLE.project(points - 1e-9 * times[:, None] * velocity).uv_px
    np.testing.assert_allclose(seen, again, atol=1e-9)
    assert np.abs(seen - PINHOLE.project(points).uv_px).max() > 1.0


def test_a_moving_box_is_masked_where_the_rows_see_it() -> None:
    box = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), np.array([[1.0, 0.0, 8.0]]))
    size, velocity = np.array([1.0, 1.0, 1.0]), np.array([10.0, 0.0, 0.0])
    points = rolling_hull_points(view(moving()), box, size, velocity)
    for corner in (np.array([0.5, -0.5, 7.5]), np.array([1.5, 0.5, 7.5])):
        low, high = -0.5, 0.5
        for _ in range(50):
            share = 0.5 * (low + high)
            camera = at(0.4 * share, 0.01 * (share + 0.5))
            place = corner + 1e-9 * share * READOUT_NS * velocity
            uv = PINHOLE.project(camera.inverse().transform(place[None])[0]).uv_px[0]
            low, high = (share, high) if (uv[1] - 0.5) / 359 - 0.5 > share else (low, share)
        assert np.linalg.norm(points - uv, axis=1).min() < 1e-2


def test_views_reach_the_rasterizer_with_both_end_poses() -> None:
    viewpoint = to_viewpoint(view(moving("left_to_right")), np.zeros(3))
    arguments = viewpoint.cameras_on(torch.device("cpu"))
    assert arguments["rolling_shutter"] == "ROLLING_LEFT_TO_RIGHT" and arguments["with_ut"] is True
    torch.testing.assert_close(arguments["viewmats"][0, :3, 3], torch.tensor([0.2, 0.0, 0.0]))
    expected = torch.from_numpy(at(0.2, 0.01).inverse().matrix()[0]).float()
    torch.testing.assert_close(arguments["viewmats_rs"][0], expected)
    still = to_viewpoint(view(None), np.zeros(3))
    assert set(still.cameras_on(torch.device("cpu"))) == {"viewmats", "Ks"}
    # the selection of what may be visible is wider: rows see beside the view of mid-exposure
    assert (viewpoint.frustum[13:17] > still.frustum[13:17]).all()


def test_absent_shutters_leave_documents_as_they_were() -> None:
    assert "shutter" not in view(None).model_dump(mode="json")
    assert "shutter" in view(moving()).model_dump(mode="json")
    plain = Pixels(space="raw", max_width_px=640)
    assert "shutter" not in plain.model_dump(mode="json")
    stated = Pixels(space="raw", max_width_px=640, shutter="calibrated")
    assert hash_document(stated.model_dump(mode="json")) != hash_document(plain.model_dump(mode="json"))
