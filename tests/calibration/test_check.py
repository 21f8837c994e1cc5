"""The check of a small dataset: a vehicle in a textured corridor, whose images show the true mounting exactly."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mirror
from mirror.calibration.check import CalibrationCheck, check_calibration
from mirror.calibration.frame_choice import FrameChoice
from mirror.calibration.spacing import ImageSpacing, PairAttempt, untracked_error
from mirror.calibration.statistics import compute_fleet_statistics
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.dataset.index import build_index
from mirror.errors import ExitCode
from mirror.geometry import Poses
from mirror.schema.files import read_table
from mirror.schema.tables import EGO_POSES
from mirror.view.calibration_page import write_calibration_page
from tests.builders.dataset import Builder, Pass
from tests.calibration.corridor import LENS, NOMINAL, corridor, padded

ERROR_DEG = np.array([0.0, 0.35, -0.45])
CHOICE = FrameChoice(frames=12, step_m=2.0)
SCALE = 1.005
"""Recorded positions relative to those of the layer `survey@1`: a drift of 0.5 %."""


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    root = tmp_path_factory.mktemp("corridor") / "ds"
    builder = Builder(root, cameras=("front_wide",), lenses={"front_wide": LENS})
    builder.scene("a")
    moving = Pass("a", frames=22, heading_deg=90.0, speed_mps=20.0, images={"front_wide": b"x" * 400_000}, codec="png")
    still = Pass("a", frames=14, entry_ns=moving.entry_ns + 10**12, speed_mps=0.0,
                 images={"front_wide": b"x"}, codec="png")  # fmt: skip
    for name in builder.drive("d", [moving, still]):
        rows = read_table(builder.layout.recorded(name) / "ego_poses.parquet", EGO_POSES).to_pylist()
        surveyed = [{**row, **{axis: row[axis] / SCALE for axis in ("tx_m", "ty_m")}} for row in rows]
        builder.layer(name, "poses", "survey@1", EGO_POSES, surveyed)
    # The recorded mounting is the nominal one; the images show one that is turned by the inverse of the error.
    error = Poses.exp(np.concatenate([np.radians(-ERROR_DEG), np.zeros(3)])[None])
    true = Poses((error @ Poses(NOMINAL.rotation, np.zeros((1, 3)))).rotation, NOMINAL.translation)
    build_index(root)
    dataset = mirror.open(root)
    for frame in dataset.where(traversal=dataset.traversals()[0]).frames():
        image = frame.images["front_wide"]
        ego = image.world_SE3_camera @ NOMINAL.inverse()
        encoded = corridor(ego @ true)
        (root / image.uri).write_bytes(padded(encoded, image.byte_length))
    return dataset


@pytest.fixture(scope="module")
def check(dataset: Dataset, tmp_path_factory: pytest.TempPathFactory) -> CalibrationCheck:
    work = tmp_path_factory.mktemp("work")
    return check_calibration(dataset, choice=CHOICE, reference_poses="survey@1", work=work)


def test_the_error_of_the_recorded_mounting_is_found(check: CalibrationCheck) -> None:
    moving = check.traversals[0]
    (one,) = moving.cameras
    assert moving.status == "checked"
    assert one.unobservable_axes() == ["roll"]
    assert one.reason == "straight driving"
    assert one.error_deg[1:] == pytest.approx(ERROR_DEG[1:], abs=0.06)
    assert one.angle_deg == pytest.approx(np.linalg.norm(ERROR_DEG[1:]), abs=0.06)
    assert one.status == "fail"
    assert check.exit_code() == ExitCode.FINDINGS


def test_the_drift_of_the_recorded_poses_is_that_of_their_scale(check: CalibrationCheck, tmp_path: Path) -> None:
    drift = check.traversals[0].drift_percent
    # The way is 44 m long, and the poses go on for 1 s at both ends.
    assert list(drift) == ["10", "20", "50"]
    assert list(drift.values()) == pytest.approx([0.5] * 3, abs=1e-6)
    write_calibration_page(check, tmp_path / "page.html")
    assert "the paper states 0.3 %" in (tmp_path / "page.html").read_text()


def test_a_standing_vehicle_is_not_checked(check: CalibrationCheck) -> None:
    still = check.traversals[1]
    assert still.status == "not checked"
    assert "vehicle that moves" in (still.message or "")
    assert check.statistics.samples == 1


def test_an_interrupted_check_continues(dataset: Dataset, tmp_path: Path) -> None:
    first = check_calibration(dataset, choice=CHOICE, work=tmp_path)
    files = sorted(tmp_path.iterdir())
    assert len(files) == 2
    # A number that no images give shows that what the files say is taken.
    for file in files:
        document = json.loads(file.read_text())
        file.write_text(json.dumps(document | {"driven_m": document["driven_m"] + 1000.0}))
    expected = [replace(one, driven_m=one.driven_m + 1000.0) for one in first.traversals]
    assert check_calibration(dataset, choice=CHOICE, work=tmp_path).traversals == expected
    # Other settings have other files.
    other = check_calibration(dataset.where(traversal=dataset.traversals()[1]), choice=FrameChoice(), work=tmp_path)
    assert other.traversals[0].status == "not checked"
    # Of a dataset in which no camera could be checked nothing is known: that is no success.
    assert other.exit_code() == ExitCode.COULD_NOT_RUN


def test_unreadable_images_are_reported(dataset: Dataset, tmp_path: Path) -> None:
    root = tmp_path / "copy"
    shutil.copytree(dataset.root, root)
    copy = mirror.open(root)
    copy = copy.where(traversal=copy.traversals()[0])
    image = copy.frames()[5].images["front_wide"]
    (root / image.uri).write_bytes(b"\0" * image.byte_length)
    found = check_calibration(copy, choice=CHOICE)
    (item,) = found.traversals
    assert item.status == "checked"
    assert len(item.unread) == 1
    assert str(image.timestamp_ns) in item.unread[0]


def test_the_page_and_the_verb(
    dataset: Dataset,
    check: CalibrationCheck,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    write_calibration_page(check, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    assert "unobservable" in text
    assert "0.3 deg" in text
    assert "<script" not in text
    code = main(["calibrate", "check", dataset.root, "--out", str(tmp_path / "out"), "--step-m", "2", "--json"])
    plain = json.loads(capsys.readouterr().out)
    assert code == plain["exit_code"] == 1
    assert json.loads((tmp_path / "out" / "calibration.json").read_text())["statistics"]["samples"] == 1
    assert (tmp_path / "out" / "report.html").is_file()
    assert main(["calibrate", "check", dataset.root, "--out", str(tmp_path / "out"), "--step-m", "2"]) == 1
    assert "roll unobservable: straight driving" in capsys.readouterr().out


def test_the_page_says_which_axes_were_observable_and_why(check: CalibrationCheck, tmp_path: Path) -> None:
    write_calibration_page(check, tmp_path / "page.html")
    table = (tmp_path / "page.html").read_text().split("Which axes were observable")[1].split("</table>")[0]
    rows = [re.findall("<td[^>]*>(.*?)</td>", row) for row in table.split("<tr>")[2:]]
    cameras = [(item, one) for item in check.traversals for one in item.cameras]
    assert len(rows) == len(cameras) > 0
    for row, (item, one) in zip(rows, cameras):
        assert row[:2] == [item.traversal_id, one.camera]
        for cell, known, sigma in zip(row[2:5], one.observable, one.sigma_deg):
            assert cell.startswith("yes" if known else "<b>no</b>") and f"{sigma:.3f}" in cell
            assert known == (sigma <= 0.1)
        assert f'<div class="whole">{one.reason or "turned "}' in row[5]
    assert any(one.reason == "straight driving" for _, one in cameras)


def test_the_page_of_a_dataset_without_estimates_has_reasons_and_no_empty_chart(
    check: CalibrationCheck, tmp_path: Path
) -> None:
    message = "none of 14 pairs of neighbouring images has 25 tracks: " + "a long reason " * 20 + "to its end"
    failed = [replace(one, status="not checked", message=message, cameras=()) for one in check.traversals]
    none = replace(check, traversals=failed, statistics=compute_fleet_statistics([], [], [], []))
    write_calibration_page(none, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text()
    charts = re.findall("<svg[^>]*>(.*?)</svg>", text, re.DOTALL)
    assert all("<rect" in chart or "<circle" in chart for chart in charts)
    assert "no camera has an estimate" in text and text.count(message) == len(failed)


def test_a_traversal_with_other_bytes_is_checked_again(dataset: Dataset, tmp_path: Path) -> None:
    root = tmp_path / "copy"
    shutil.copytree(dataset.root, root)
    copy = mirror.open(root)
    copy = copy.where(traversal=copy.traversals()[0])
    image = copy.frames()[5].images["front_wide"]
    whole = (root / image.uri).read_bytes()
    first = check_calibration(copy, choice=CHOICE, work=tmp_path / "work")
    # What could not be read is no result: the next check reads it again.
    (root / image.uri).unlink()
    (root / image.uri).write_bytes(b"\0" * image.byte_length)
    broken = check_calibration(copy, choice=CHOICE, work=tmp_path / "work")
    assert len(broken.traversals[0].unread) == 1 and not first.traversals[0].unread
    assert len(list((tmp_path / "work").iterdir())) == 1
    (root / image.uri).write_bytes(whole)
    assert check_calibration(copy, choice=CHOICE, work=tmp_path / "work").traversals == first.traversals


def test_images_that_are_too_far_apart_are_named_with_the_rate_they_need(tmp_path: Path) -> None:
    builder = Builder(tmp_path / "ds", cameras=("front_wide",), lenses={"front_wide": LENS})
    builder.scene("a")
    sparse = Pass("a", frames=12, heading_deg=90.0, speed_mps=200.0, images={"front_wide": b"x" * 400_000}, codec="png")
    builder.drive("d", [sparse])
    build_index(tmp_path / "ds")
    dataset = mirror.open(tmp_path / "ds")
    spacing = []
    for number, frame in enumerate(dataset.frames()):
        image = frame.images["front_wide"]
        # Each image shows another place of the corridor: no point is in two of them.
        at = image.world_SE3_camera
        elsewhere = Poses(at.rotation, at.translation + np.array([317.0 * number, 0.0, 0.0]))
        (tmp_path / "ds" / image.uri).write_bytes(padded(corridor(elsewhere), image.byte_length))
        spacing.append(frame.world_SE3_ego.translation[0])
    apart = float(np.median(np.linalg.norm(np.diff(spacing, axis=0), axis=1)))
    (item,) = check_calibration(dataset).traversals
    message = item.message or ""
    assert item.status == "not checked"
    assert f"the images are {apart:.1f} m" in message
    assert "25 tracks" in message
    assert f"{apart / 3.5 / 0.1:.2g} a second" in message
    assert "vehicle moves" not in message


def test_a_standing_vehicle_does_not_hide_how_far_apart_images_are() -> None:
    """Three of four pairs are of the halt; a remedy by their spacing would name the step that is in use."""
    x = np.array([0.0, 30.0, 30.0, 30.0, 30.01, 30.0, 30.0, 60.0])
    poses = Poses(np.tile([1.0, 0.0, 0.0, 0.0], (8, 1)), np.stack([x, 0 * x, 0 * x], axis=1))
    spacing = ImageSpacing.of(poses, [number * 2_000_000_000 for number in range(8)])
    assert spacing == ImageSpacing(30.0, 0.0, 2.0)
    standing = ImageSpacing.of(poses[1:7], [number * 2_000_000_000 for number in range(6)])
    assert (standing.distance_m, standing.interval_s) == (0.0, 2.0)
    few = [PairAttempt("a", 400, 3)]
    assert "record at a higher rate" in str(untracked_error(few, 25, spacing, spacing))


def test_the_error_of_untracked_images_names_the_measured_cause() -> None:
    far, near = ImageSpacing(15.0, 0.0, 1.0), ImageSpacing(3.0, 0.0, 0.2)
    few = [PairAttempt("a", 400, 3), PairAttempt("a", 380, 12)]
    error = untracked_error(few, 25, far, far)
    assert "4.3 a second" in str(error) and "390 points" in str(error) and "12 at most" in str(error)
    assert "--step-m 3.5" in str(untracked_error(few, 25, far, near))
    assert "apart, which are" not in str(untracked_error(few, 25, near, near))
    assert "texture" in str(untracked_error([PairAttempt("a", 3, 0)], 25, near, near))
    assert "neighbouring frames" in str(untracked_error([], 25, far, far))
