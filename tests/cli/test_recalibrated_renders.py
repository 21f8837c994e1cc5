"""A model that was trained with a layer of calibrations is rendered with it, in the raster of the protocol."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from hybridworldsim.methods.street import open_model
from mirror.cli.main import main
from mirror.dataset import Dataset
from mirror.dataset.index import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout
from mirror.errors import ExitCode
from mirror.geometry import Poses, matrix_from_quaternion
from mirror.geometry.cameras import Camera
from mirror.methods.appearance import AppearancePolicy
from mirror.protocols.document import load_protocol
from mirror.protocols.views import plan_views
from mirror.protocols.views.final_camera import final_camera
from mirror.protocols.views.recalibration import lens_in_raster, recalibrate_views
from mirror.schema.tables import CALIBRATIONS, POINTS
from tests.baselines.conftest import dataset as street  # noqa: F401 - a fixture

LAYER = "refined@1"


@pytest.fixture
def dataset(street: Dataset) -> Dataset:  # noqa: F811
    """The street with points, and with other calibrations of its training traversals and one of two held-out ones."""
    layout = Layout(Path(street.root))
    for traversal in street.traversals():
        frame = street.where(traversal=traversal).frames()[0]
        turn = Poses.exp(np.array([[0.0, 0.05, 0.02, 0.0, 0.0, 0.1]]))
        rows = []
        for used in frame.calibrations:
            pose = {name: float(value[0]) for name, value in (used.ego_SE3_camera @ turn).to_columns().items()}
            lens = {"fx_px": 1.01 * used.model.fx_px, "fy_px": 1.01 * used.model.fy_px, "cx_px": used.model.cx_px + 0.5}
            rows.append({**used.row, **pose, **lens, "stage": "refined"})
        LayerWriter(layout, traversal, "calibrations", "refined", "1").finish(CALIBRATIONS, rows, {})
        points = [
            {
                "point": number, "x_m": float(number % 20 - 10), "y_m": 12.0, "z_m": float(number // 20), "r": 90,
                "g": 9, "b": 90, "kind": "background", "views": 3, "sigma_m": None,
            }
            for number in range(60)
        ]  # fmt: skip
        if traversal in street.where(split="novel", role="train").traversals():
            LayerWriter(layout, traversal, "points", "made", "1").finish(POINTS, points, {})
    build_index(Path(street.root))
    return mirror.open(street.root)


def test_views_are_where_the_layer_has_the_cameras(dataset: Dataset) -> None:
    planned = plan_views(dataset, load_protocol("static-reconstruction"), "novel").views
    moved = recalibrate_views(dataset, planned, LAYER)
    assert recalibrate_views(dataset, planned, "recorded") == planned
    refined = dataset.with_layers(calibrations=LAYER)
    for before, after in zip(planned, moved, strict=True):
        frame = refined.where(traversal=before.traversal_id).frames()[before.frame_index]
        expected = frame.images[before.camera].world_SE3_camera
        np.testing.assert_allclose(after.pose.translation, expected.translation, atol=1e-9)
        np.testing.assert_allclose(
            matrix_from_quaternion(after.pose.rotation), matrix_from_quaternion(expected.rotation), atol=1e-12
        )
        assert (after.path, after.width_px, after.height_px) == (before.path, before.width_px, before.height_px)
        assert (after.fx_px, after.cx_px) == pytest.approx((1.01 * before.fx_px, before.cx_px + 0.5))


def test_views_without_the_layer_stay(dataset: Dataset) -> None:
    planned = plan_views(dataset, load_protocol("static-reconstruction"), "novel").views
    held_out = next(view.traversal_id for view in planned if view.group == "novel")
    layer = Layout(Path(dataset.root)).layer(held_out, "calibrations", "refined", "1")
    for file in layer.iterdir():
        file.unlink()
    layer.rmdir()
    build_index(Path(dataset.root))
    moved = recalibrate_views(mirror.open(dataset.root), planned, LAYER)
    assert all((before == after) == (before.traversal_id == held_out) for before, after in zip(planned, moved))


def test_an_undistorted_raster_keeps_its_pixels() -> None:
    """Independent: OpenCV projects points by the refined lens, and undistorts the image by the recorded one."""
    recorded = Camera("brown_conrady", 960, 540, 500.0, 505.0, 478.0, 272.0, (-0.2, 0.05, 1e-3, -5e-4, 0.0))
    refined = replace(recorded, fx_px=500.4, fy_px=505.4, cx_px=478.5, cy_px=271.7)
    raster = final_camera(recorded, load_protocol("static-reconstruction").pixels)
    lens = lens_in_raster(raster, recorded, refined)
    grid = np.stack(np.meshgrid(np.linspace(-0.7, 0.7, 15), np.linspace(-0.35, 0.35, 9)), axis=-1).reshape(-1, 2)
    points = np.column_stack([grid, np.ones(len(grid))])
    matrix, other = (np.array([[c.fx_px, 0, c.cx_px], [0, c.fy_px, c.cy_px], [0, 0, 1]]) for c in (refined, recorded))
    image, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), matrix, np.array(recorded.distortion))
    flat = cv2.undistortPoints(
        image,
        other,
        np.array(recorded.distortion),
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12),
    )[:, 0]
    expected = flat * (raster.fx_px, raster.fy_px) + (raster.cx_px, raster.cy_px)
    off = np.linalg.norm(lens.project(points).uv_px - expected, axis=1)
    assert off.max() < 0.15 < np.linalg.norm(raster.project(points).uv_px - expected, axis=1).min()


def said(capsys: pytest.CaptureFixture[str], *words: object, code: int = ExitCode.DONE) -> dict[str, object]:
    assert main([str(word) for word in (*words, "--json")]) == code
    return json.loads(capsys.readouterr().out)


def test_a_model_is_rendered_with_the_calibrations_of_its_training(
    dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, root = tmp_path / "model", dataset.root
    words = ("reconstruct", root, "--split", "novel", "--out", model, "--steps", 4, "--width", 48, "--threads", 1)
    said(capsys, *words, "--calibrations", LAYER)
    refused = said(capsys, *words, code=ExitCode.COULD_NOT_RUN)
    assert f"calibrations {LAYER}" in str(refused["problem"])
    for name, more in (("own", ()), ("recorded", ("--calibrations", "recorded"))):
        said(capsys, "render", root, model, "--split", "novel", "--out", tmp_path / name, *more)
    plan = plan_views(dataset.with_layers(calibrations=LAYER), load_protocol("static-reconstruction"), "novel")
    draw = open_model(model, AppearancePolicy(views=plan.views))
    for view in plan.views[::5]:
        own, recorded = (cv2.imread(str(tmp_path / name / view.path))[..., ::-1] for name in ("own", "recorded"))
        np.testing.assert_array_equal(own, draw(view))
        assert not np.array_equal(own, recorded)
    trained_on = {
        name: json.loads((tmp_path / name / "manifest.json").read_text())["method"]["trained_on"]
        for name in ("own", "recorded")
    }
    assert trained_on["own"].endswith(f"; calibrations {LAYER}")
    assert trained_on["recorded"].endswith(f"; calibrations {LAYER}, rendered with recorded")
    assert main(["submission", "check", str(root), str(tmp_path / "own")]) == ExitCode.DONE
