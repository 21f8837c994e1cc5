"""Lenses from images of boards: rendered boards against the exact lens, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.calibration.boards import CalibrationBoard, find_size
from mirror.calibration.intrinsics import Intrinsics, calibrate_intrinsics
from mirror.cli.main import main
from mirror.errors import UsageError
from mirror.geometry.cameras import Camera
from mirror.recordings.lens_files import read_lens
from tests.builders.small_folder import write_recording
from tests.calibration.boards import TURNS, view

LENS = Camera("brown_conrady", 480, 360, 400.0, 402.0, 243.0, 178.0, (-0.12, 0.05, 0.0004, -0.0003, 0.0))
FISHEYE = Camera("kannala_brandt", 480, 360, 200.0, 201.0, 243.0, 178.0, (0.03, -0.01, 0.0, 0.0))


def views(lens: Camera, board: CalibrationBoard, distance: float = 12.0) -> list[tuple[str, np.ndarray]]:
    """Six boards in different orientations."""
    middle = (-(board.columns - 1) / 2.0, -(board.rows - 1) / 2.0)
    return [
        (f"{number}.png", view(lens, board, turn, (*middle, distance + 0.5 * number)))
        for number, turn in enumerate(TURNS)
    ]


def assert_lens(found: Intrinsics, lens: Camera, tolerance_px: float) -> None:
    """Within the tolerance, and within four of the stated standard deviations plus a tenth of a pixel."""
    for name in ("fx_px", "fy_px", "cx_px", "cy_px"):
        error = abs(getattr(found.camera, name) - getattr(lens, name))
        assert error < tolerance_px, name
        assert error < 4.0 * found.sigma[name] + 0.1, name


@pytest.fixture(scope="module")
def chessboards() -> list[tuple[str, np.ndarray]]:
    return views(LENS, CalibrationBoard(9, 6))


def test_chessboards_give_the_exact_lens(chessboards: list[tuple[str, np.ndarray]]) -> None:
    blank, small = ("blank.png", np.full((360, 480), 128, np.uint8)), ("small.png", chessboards[0][1][:300])
    found = calibrate_intrinsics([*chessboards, blank, small], CalibrationBoard(9, 6))
    assert list(found.image_rms_px) == [name for name, _ in chessboards]
    assert set(found.rejected) == {"blank.png", "small.png"}
    assert found.rms_px < 0.2
    # Half a pixel of convention would show here.
    assert_lens(found, LENS, 1.0)
    assert 0.3 < found.covered < 1.0 and 0.3 < found.reach < 1.0 and found.spread_deg > 30.0
    assert any("images were used" in doubt for doubt in found.doubts())


def test_the_covariance_is_that_of_opencv(chessboards: list[tuple[str, np.ndarray]]) -> None:
    board = CalibrationBoard(9, 6)
    found = calibrate_intrinsics(chessboards, board)
    corners = []
    done = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 1e-3)
    for _, image in chessboards:
        complete, pixels = cv2.findChessboardCorners(image, (9, 6))
        assert complete
        corners.append(cv2.cornerSubPix(image, pixels, (7, 7), (-1, -1), done))
    theirs = cv2.calibrateCameraExtended([board.corners] * len(corners), corners, (480, 360), None, None)
    np.testing.assert_allclose(list(found.sigma.values()), np.ravel(theirs[5])[:9], rtol=0.05)
    np.testing.assert_allclose(list(found.image_rms_px.values()), np.ravel(theirs[7]), rtol=1e-3)


def test_charuco_boards_and_fisheyes_give_the_exact_lens() -> None:
    charuco = CalibrationBoard(8, 5, "charuco")
    assert_lens(calibrate_intrinsics(views(LENS, charuco, 8.5), charuco), LENS, 1.0)
    found = calibrate_intrinsics(views(FISHEYE, CalibrationBoard(9, 6), 7.0), CalibrationBoard(9, 6), "kannala_brandt")
    assert_lens(found, FISHEYE, 1.0)


def test_what_makes_no_lens_is_refused(chessboards: list[tuple[str, np.ndarray]]) -> None:
    for stated in (CalibrationBoard(10, 7), CalibrationBoard(7, 5)):
        with pytest.raises(UsageError) as refused:
            calibrate_intrinsics(chessboards, stated)
        assert refused.value.remedy == "--board 9x6"
    assert find_size(chessboards[0][1]) == (9, 6)
    with pytest.raises(UsageError, match="2 of 2 images"):
        calibrate_intrinsics(chessboards[:2], CalibrationBoard(9, 6))
    with pytest.raises(UsageError, match="0 of 0 images"):
        calibrate_intrinsics([], CalibrationBoard(9, 6))
    flat = [
        (
            f"{number}.png",
            view(LENS, CalibrationBoard(9, 6), (0.01 * number, 0.0, 0.1), (-4.0 + number, -2.5, 11.0 + number)),
        )
        for number in range(4)
    ]
    with pytest.raises(UsageError, match="orientation"):
        calibrate_intrinsics(flat, CalibrationBoard(9, 6))
    with pytest.raises(UsageError) as refused:
        CalibrationBoard(8, 5, "charuco", "DICT_NONE")
    assert refused.value.place == "--dictionary"


def test_the_command_writes_the_lens_into_a_recording(
    chessboards: list[tuple[str, np.ndarray]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "boards"
    folder.mkdir()
    for name, image in chessboards:
        cv2.imwrite(str(folder / name), image)
    camera = {"front_wide": {"source_name": "cam0", "calibrated": False}}
    recording = write_recording(tmp_path / "drive", cameras=camera)
    command = ["calibrate", "intrinsics", str(folder), "--board", "9x6", "--out", str(tmp_path / "lens.yaml")]
    into = ["--recording", str(recording), "--camera", "front_wide"]
    assert main([*command, *into]) == 2
    assert "--mounting" in capsys.readouterr().err
    assert not (tmp_path / "lens.yaml").exists()
    assert main([*command, *into, "--mounting", "1.5,0,1.4,0,0,0", "--json"]) == 1
    printed = json.loads(capsys.readouterr().out)
    lens = read_lens(tmp_path / "lens.yaml")
    assert (lens.fx_px, lens.cx_px) == pytest.approx((printed["fx_px"], printed["cx_px"]))
    (written,) = json.loads((recording / "calibrations" / "factory.json").read_text())
    assert written["fx_px"] == printed["fx_px"] and written["cx_px"] == printed["cx_px"]
    assert written["ego_SE3_camera"] == pytest.approx([0.5, -0.5, 0.5, -0.5, 1.5, 0.0, 1.4])
    assert "calibrated" not in json.loads((recording / "recording.json").read_text())["cameras"]["front_wide"]
    # Again: the mounting is known now.
    assert main([*command, *into]) == 1
    assert main([*command[:4], "9by6", *command[5:]]) == 2


@pytest.mark.real_data
def test_real_images(real_data: Path) -> None:
    files = sorted((real_data / "chessboard").glob("*.jpg"))
    images = [(file.name, cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)) for file in files]
    found = calibrate_intrinsics(images, CalibrationBoard(9, 6))
    assert len(found.image_rms_px) >= 8
    assert found.rms_px < 1.5
    assert 0.5 < found.camera.fx_px / found.camera.width_px < 2.0
    assert abs(found.camera.fy_px / found.camera.fx_px - 1.0) < 0.02
