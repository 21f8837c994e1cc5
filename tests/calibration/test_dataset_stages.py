"""The calibration stages of a dataset: each pair of stages of a camera, jumps in time, and what is static in images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mirror
from mirror.calibration.sampling import static_pixels
from mirror.calibration.stages import StageDifference, compare_stages
from mirror.dataset.index import build_index
from mirror.geometry import Poses
from mirror.schema.tables import BOXES, CALIBRATIONS
from mirror.view.cameras_figure import cameras_figure
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass, box, calibration

CAMERAS = ("front_wide", "rear")
ONLINE_DEG, REFINED_DEG, LATER_DEG = 0.5, 0.7, 0.2
"""Turns about the vehicle's z: of the stages online and refined, and of the factory stage of the second drive."""


def turned(camera: str, number: int, angle_deg: float, **more: object) -> dict[str, object]:
    """A row of the calibrations table whose camera is turned about the vehicle's z."""
    row = calibration(camera, number, (48, 32), **more)
    rotation = np.array([[row[name] for name in ("qw", "qx", "qy", "qz")]])
    turn = Poses.exp(np.radians([[0.0, 0.0, angle_deg, 0.0, 0.0, 0.0]]))
    (quaternion,) = (turn @ Poses(rotation, np.zeros((1, 3)))).rotation
    return {**row, **dict(zip(("qw", "qx", "qy", "qz"), quaternion.tolist()))}


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two drives of vehicle v1 and one of v2, each with the stage factory; the first has two more as layers."""
    builder = Builder(tmp_path_factory.mktemp("stages") / "ds", cameras=CAMERAS)
    builder.scene("a")
    ids = []
    for number, (drive, vehicle) in enumerate((("d1", "v1"), ("d2", "v1"), ("e1", "v2"))):
        ids += builder.drive(drive, [Pass("a", EPOCH + number * 10**13, frames=2)], vehicle_id=vehicle)
    for stage, angle in (("online", ONLINE_DEG), ("refined", REFINED_DEG)):
        rows = [
            turned(camera, number, angle, vehicle_id="v1", drive_id="d1", stage=stage)
            for number, camera in enumerate(CAMERAS)
        ]
        builder.layer(ids[0], "calibrations", f"{stage}@1", CALIBRATIONS, rows)
    later = [
        turned(camera, number, LATER_DEG, vehicle_id="v1", drive_id="d2", valid_from_ns=EPOCH + 10**13 + SECOND)
        for number, camera in enumerate(CAMERAS)
    ]
    builder.layer(ids[1], "calibrations", "workshop@1", CALIBRATIONS, later)
    stamp = EPOCH
    boxes = [
        box(stamp, "moving", vx_mps=5.0, vy_mps=0.0, vz_mps=0.0),
        box(stamp, "parked", tx_m=30.0, ty_m=8.0, vz_mps=0.0),
    ]
    builder.layer(ids[0], "boxes", "petr@1", BOXES, boxes)
    build_index(builder.root)
    return builder.root


def test_each_pair_of_stages_is_compared_for_each_vehicle_drive_and_camera(root: Path) -> None:
    found = compare_stages(mirror.open(root))
    expected = {("factory", "online"): ONLINE_DEG, ("factory", "refined"): REFINED_DEG}
    expected["online", "refined"] = REFINED_DEG - ONLINE_DEG

    def place(one: StageDifference) -> tuple[str, ...]:
        return one.vehicle_id, one.drive_id, one.camera, one.first, one.second

    assert {place(one) for one in found.between_stages} == {
        ("v1", "d1", camera, *stages) for camera in CAMERAS for stages in expected
    }
    assert len(found.between_stages) == 2 * 3
    for one in found.between_stages:
        assert one.axes_deg == pytest.approx((0.0, 0.0, expected[one.first, one.second]), abs=1e-9)
        assert one.distance_cm == pytest.approx(0.0, abs=1e-9)


def test_a_jump_in_time_is_found_where_its_validity_begins(root: Path) -> None:
    jumps = [one for one in compare_stages(mirror.open(root)).in_time if one.is_jump]
    assert [(one.vehicle_id, one.drive_id, one.camera, one.first) for one in jumps] == [
        ("v1", "d2", camera, "factory") for camera in CAMERAS
    ]
    for one in jumps:
        assert one.at_ns == EPOCH + 10**13 + SECOND
        assert one.angle_deg == pytest.approx(LATER_DEG, abs=1e-9)


def test_moving_boxes_are_masked_and_parked_ones_are_not(root: Path) -> None:
    frame = mirror.open(root).frames()[0]
    image = frame.images["front_wide"]
    still = static_pixels(frame, image)
    boxes = frame.boxes("camera:front_wide")
    inside = {}
    for name, pose in zip(("moving", "parked"), (boxes.pose[0:1], boxes.pose[1:2])):
        (u, v), *_ = image.camera_model.project(pose.translation).uv_px
        inside[name] = bool(still[int(v), int(u)])
    assert inside == {"moving": False, "parked": True}
    assert 0.5 < still.mean() < 1.0


def test_the_figure_has_one_vehicle_a_rig_and_a_bar_for_each_difference(root: Path) -> None:
    pytest.importorskip("matplotlib", reason="the extra view is not installed")
    figure = cameras_figure(mirror.open(root))
    assert figure is not None
    street, *bars = figure.axes
    assert [patch.get_gid() for patch in street.patches].count("vehicle") == 1
    assert sorted(text.get_text() for text in street.texts) == sorted(CAMERAS)
    angles, distances = ([patch.get_width() for patch in axes.patches] for axes in bars)
    # By camera: factory to online, factory to refined, online to refined.
    expected = [ONLINE_DEG, REFINED_DEG, REFINED_DEG - ONLINE_DEG] * len(CAMERAS)
    assert sorted(angles) == pytest.approx(sorted(expected), abs=1e-9)
    assert distances == pytest.approx([0.0] * len(expected), abs=1e-9)
