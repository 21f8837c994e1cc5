"""51 frames of KITTI odometry: figures of the files, images that agree with poses and lens, and a checked dataset."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.cli.main import main
from mirror.errors import ExitCode
from mirror.geometry.cameras import camera_from_row
from mirror.geometry.poses import COLUMNS, Poses
from mirror.geometry.quaternions import matrix_from_quaternion
from mirror.recordings.protocol import Recording
from mirror.recordings.registry import open_recording

# x forward, y left, z up in the axes of a camera.
TURN = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


@pytest.fixture(scope="module")
def folder(real_data: Path) -> Path:
    path = real_data / "kitti_odometry_a"
    if not path.is_dir():
        pytest.skip("needs the folder kitti_odometry_a of the real recordings")
    return path


def camera_poses(recording: Recording) -> Poses:
    """World from camera at every frame, in the frame of the recording."""
    track, (row,) = recording.track(), recording.calibrations().to_pylist()
    assert track.rotation is not None
    ego = Poses(track.rotation, np.column_stack([track.x_m, track.y_m, track.height_m]))
    return ego @ Poses.from_columns({name: [row[name]] * len(ego) for name in COLUMNS})


@pytest.mark.real_data
def test_the_numbers_are_those_of_the_files(folder: Path) -> None:
    recording = open_recording(folder)
    poses = camera_poses(recording)
    expected = np.loadtxt(folder / "poses" / "99.txt").reshape(-1, 3, 4)
    assert np.abs(poses.translation @ TURN.T - expected[:, :, 3]).max() < 1e-9
    # The files have seven digits.
    assert np.abs(TURN @ matrix_from_quaternion(poses.rotation) - expected[:, :, :3]).max() < 1e-6
    seconds = np.loadtxt(folder / "sequences" / "99" / "times.txt")
    assert np.abs(recording.track().timestamp_ns * 1e-9 - seconds).max() < 1e-9
    camera = camera_from_row(recording.calibrations().to_pylist()[0])
    assert (camera.width_px, camera.height_px) == (1226, 370)
    words = (folder / "sequences" / "99" / "calib.txt").read_text().split()
    assert camera.intrinsic_matrix(first_pixel_centre=0.0)[0].tolist() == [float(word) for word in words[1:4]]


@pytest.mark.real_data
def test_images_agree_with_poses_and_lens(folder: Path) -> None:
    """Matches of points lie on their epipolar lines; the published rotations of frames 0 to 8 are 0.2 degrees off."""
    recording = open_recording(folder)
    poses = camera_poses(recording)
    matrix = camera_from_row(recording.calibrations().to_pylist()[0]).intrinsic_matrix(first_pixel_centre=0.0)
    inverse = np.linalg.inv(matrix)
    frames = [12, 14, 24, 26, 36, 38]
    images = recording.images()["image_0"].read(frames)
    decoded = {n: cv2.imdecode(np.frombuffer(data, np.uint8), 0) for n, data in images}
    sift = cv2.SIFT_create(2000)
    for first, second in zip(frames[::2], frames[1::2]):
        (here, a), (there, b) = (sift.detectAndCompute(decoded[n], None) for n in (first, second))
        pairs = [m for m, other in cv2.BFMatcher().knnMatch(a, b, k=2) if m.distance < 0.7 * other.distance]
        x = np.array([(*here[m.queryIdx].pt, 1.0) for m in pairs])
        y = np.array([(*there[m.trainIdx].pt, 1.0) for m in pairs])
        motion = poses[np.array([second])].inverse() @ poses[np.array([first])]
        off = []
        for one in (motion.matrix()[0], motion.inverse().matrix()[0]):
            fundamental = inverse.T @ np.cross(np.eye(3), one[:3, 3]).T @ one[:3, :3] @ inverse
            lines = x @ fundamental.T
            off.append(np.median(np.abs((y * lines).sum(axis=1)) / np.hypot(lines[:, 0], lines[:, 1])))
        assert len(pairs) > 300 and off[0] < 0.6 < 2.0 * off[0] < off[1], (first, off)


@pytest.mark.real_data
def test_the_sequence_becomes_a_checked_dataset(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["info", str(folder), "--json"]) == ExitCode.DONE
    said = json.loads(capsys.readouterr().out)
    assert said["poses"] == said["usable"] == 51 and said["cameras"]["image_0"]["rate_hz"] == 10.0
    rois, dataset = str(tmp_path / "rois.geojson"), str(tmp_path / "d")
    short = ("--min-duration-s", "1")
    propose = ["rois", "propose", str(folder), "--count", "1", "--min-traversals", "1", *short, "--out", rois]
    assert main(propose) == ExitCode.DONE
    assert main(["ingest", str(folder), "--rois", rois, *short, "--out", dataset]) == ExitCode.DONE
    capsys.readouterr()
    assert main(["check", dataset, "--json"]) == ExitCode.DONE
    counts = json.loads(capsys.readouterr().out)["counts"]
    assert counts["error"] == counts["warning"] == 0
