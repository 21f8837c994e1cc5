"""Images of rolling shutters: poses and boxes at the times of their rows."""

from __future__ import annotations

import numpy as np
import pytest

import mirror
from mirror.annotation.masks import draw_hulls, draw_rolling_hulls
from mirror.dataset.dataset import Dataset
from mirror.dataset.index.build import build_index
from mirror.errors import DatasetError
from mirror.geometry import Poses
from mirror.protocols.document import Pixels
from mirror.protocols.views.trajectories import plan_views_along, recorded_trajectory
from tests.builders.dataset import EPOCH, Builder, Pass

READOUT_NS, SPEED_MPS = 40_000_000, 15.0


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    root = tmp_path_factory.mktemp("rolling")
    builder = Builder(
        root, cameras=("front_wide",), shutter={"shutter_direction": "top_to_bottom", "readout_ns": READOUT_NS}
    )
    builder.scene("a")
    builder.drive("d0", [Pass("a", frames=6, speed_mps=SPEED_MPS)])
    build_index(root)
    return mirror.open(root)


def test_rows_have_poses_of_their_own(dataset: Dataset) -> None:
    image = dataset.frames()[2].images["front_wide"]
    assert (image.shutter.direction, image.shutter.readout_ns) == ("top_to_bottom", READOUT_NS)
    ends = image.world_SE3_camera_at(image.shutter.line_offsets_ns()[[0, -1]])
    moved = np.linalg.norm(ends.translation[1] - ends.translation[0])
    assert moved == pytest.approx(SPEED_MPS * READOUT_NS * 1e-9, rel=1e-6)
    middle = 0.5 * (ends.translation[0] + ends.translation[1])
    np.testing.assert_allclose(middle, image.world_SE3_camera.translation[0], atol=1e-6)


def test_rows_just_beyond_the_poses_keep_the_velocity_and_others_are_refused(dataset: Dataset) -> None:
    frame = dataset.frames()[0]
    image, (stamps, _) = frame.images["front_wide"], frame.track
    before_ns = float(stamps[0] - image.timestamp_ns)
    steps = image.world_SE3_camera_at([before_ns - 30e6, before_ns, before_ns + 30e6]).translation
    np.testing.assert_allclose(steps[1] - steps[0], steps[2] - steps[1], atol=1e-6)
    with pytest.raises(DatasetError, match="outside the recorded poses"):
        image.world_SE3_camera_at([before_ns - 300e6])


def test_moving_boxes_are_masked_where_the_rows_see_them(dataset: Dataset) -> None:
    image = dataset.frames()[2].images["front_wide"]
    pose = image.world_SE3_camera
    centre = pose.transform(np.array([[0.6, 0.3, 4.0]]))[0]
    box, size = Poses(pose.rotation, centre), np.array([[1.0, 1.0, 1.0]])
    forward = pose.transform(np.array([[0.0, 0.0, 1.0]]))[0, 0] - pose.translation[0]
    along, still = SPEED_MPS * forward[None], np.zeros((1, 3))
    plain = draw_hulls(image.camera_model, pose.inverse() @ box, size)
    # what moves with the camera looks as it does at mid-exposure; what stands comes nearer from row to row
    carried, standing = draw_rolling_hulls(image, box, size, along), draw_rolling_hulls(image, box, size, still)
    assert (carried != plain).mean() < 0.01
    assert (standing != plain).sum() > (carried != plain).sum()
    seen = image.project_moving(centre, still)[0]
    time_ns = image.shutter.offsets_ns(seen)
    there = image.world_SE3_camera_at(time_ns).inverse().transform(centre)[0]
    np.testing.assert_allclose(image.camera_model.project(there).uv_px[0], seen, atol=1e-6)


def test_views_along_a_trajectory_have_the_shutter_that_the_protocol_asks_for(dataset: Dataset) -> None:
    name = dataset.traversals()[0]
    way = recorded_trajectory(dataset, name)
    plain = plan_views_along(dataset, name, way, Pixels(space="raw", max_width_px=48))
    assert all(view.shutter is None for view in plain)
    rolling = plan_views_along(dataset, name, way, Pixels(space="raw", max_width_px=48, shutter="calibrated"))
    assert len(rolling) == len(plain) and way.timestamps_ns[0] >= EPOCH
    for view in rolling:
        assert view.shutter is not None and view.shutter.direction == "top_to_bottom"
        ends = view.shutter.world_SE3_last.translation - view.shutter.world_SE3_first.translation
        assert np.linalg.norm(ends) == pytest.approx(SPEED_MPS * READOUT_NS * 1e-9, rel=1e-6)
