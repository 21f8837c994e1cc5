"""The check of a small dataset: a vehicle in a textured corridor, whose images show the true mounting exactly."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from mirror.calibration.check import CalibrationCheck, check_calibration
from mirror.calibration.frame_choice import FrameChoice
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.dataset.index import build_index
from mirror.errors import ExitCode
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.view.calibration_page import write_calibration_page
from tests.dataset.builders import Builder, Pass

LENS = Camera("pinhole", 400, 300, 320.0, 320.0, 201.0, 149.0)
NOMINAL = Poses(np.array([[0.5, -0.5, 0.5, -0.5]]), np.array([[1.5, 0.0, 1.6]]))
ERROR_DEG = np.array([0.0, 0.35, -0.45])
CHOICE = FrameChoice(frames=12, step_m=2.0)


def corridor(camera_pose: Poses) -> np.ndarray:
    """A PNG of what the camera sees between two walls, a floor and a ceiling, all textured."""
    rng = np.random.default_rng(1)
    noise = cv2.GaussianBlur(rng.normal(size=(512, 512)).astype(np.float32), (0, 0), 2.0)
    noise = np.clip(128.0 + 45.0 * noise / noise.std(), 0, 255)
    rays = LENS.rays().direction.reshape(-1, 3)
    origin = camera_pose.translation[0]
    way = camera_pose.transform(rays)[0] - origin
    with np.errstate(divide="ignore"):
        to_walls = np.where(way[:, 1] > 0, 6.0 - origin[1], -6.0 - origin[1]) / way[:, 1]
        to_floor = np.where(way[:, 2] > 0, 8.0 - origin[2], -origin[2]) / way[:, 2]
    hit = origin + np.minimum(to_walls, to_floor)[:, None] * way
    across = np.where(to_walls < to_floor, hit[:, 2] + 40.0 * np.sign(way[:, 1]), hit[:, 1])
    maps = [(25.0 * value % 511.0).reshape(300, 400).astype(np.float32) for value in (hit[:, 0], across)]
    # Far away the texture is finer than a pixel: it fades out.
    far = np.clip(1.5 - np.linalg.norm(hit - origin, axis=1) / 40.0, 0.0, 1.0).reshape(300, 400)
    grey = 128.0 + far * (cv2.remap(noise, *maps, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP) - 128.0)
    return cv2.imencode(".png", np.repeat(grey[..., None], 3, axis=2).astype(np.uint8))[1].tobytes()


def padded(png: bytes, length: int) -> bytes:
    """A PNG with a text chunk, so that it has the length that the rows state."""
    text = b"tEXt" + b"pad\0" + b" " * (length - len(png) - 16)
    return png[:-12] + struct.pack(">I", len(text) - 4) + text + struct.pack(">I", zlib.crc32(text)) + png[-12:]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    root = tmp_path_factory.mktemp("corridor") / "ds"
    builder = Builder(root, cameras=("front_wide",), lenses={"front_wide": LENS})
    builder.scene("a")
    moving = Pass("a", frames=22, heading_deg=90.0, speed_mps=20.0, images={"front_wide": b"x" * 400_000}, codec="png")
    still = Pass("a", frames=14, entry_ns=moving.entry_ns + 10**12, speed_mps=0.0,
                 images={"front_wide": b"x"}, codec="png")  # fmt: skip
    builder.drive("d", [moving, still])
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
    return check_calibration(dataset, choice=CHOICE, work=tmp_path_factory.mktemp("work"))


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


def test_a_standing_vehicle_is_not_checked(check: CalibrationCheck) -> None:
    still = check.traversals[1]
    assert still.status == "not checked"
    assert "vehicle that moves" in (still.message or "")
    assert check.statistics.samples == 1


def test_an_interrupted_check_continues(dataset: Dataset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = check_calibration(dataset, choice=CHOICE, work=tmp_path)
    files = sorted(tmp_path.iterdir())
    assert len(files) == 2
    monkeypatch.setattr("mirror.calibration.check.track_traversal", None)
    assert check_calibration(dataset, choice=CHOICE, work=tmp_path).traversals == first.traversals
    # Other settings have other files.
    other = check_calibration(dataset.where(traversal=dataset.traversals()[1]), choice=FrameChoice(), work=tmp_path)
    assert other.traversals[0].status == "not checked"


def test_unreadable_images_are_reported(dataset: Dataset, tmp_path: Path) -> None:
    import shutil

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
