"""The KITTI export, read by the definitions in the readme files of KITTI's own devkits."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.dataset.dataset import Dataset
from mirror.export.run import ExportOptions, export
from mirror.geometry.boxes import corners
from mirror.geometry.cameras import undistorted


@pytest.fixture(scope="module")
def out(street: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kitti") / "out"
    written = export(street, "kitti", folder, ExportOptions(undistort=True, split="novel"))
    assert written.boxes > 0
    return folder


def matrices(path: Path) -> dict[str, np.ndarray]:
    """The 3x4 matrices of a calibration file, by name."""
    lines = (line.split(":") for line in path.read_text().splitlines())
    return {name: np.array(numbers.split(), float).reshape(3, 4) for name, numbers in lines}


def label_corners(words: list[str]) -> np.ndarray:
    """Corners (8, 3) of a label in camera coordinates, as the object devkit's readme defines them."""
    height, width, length, x, y, z, rotation = map(float, words[10:17])
    along = length / 2 * np.array([1, 1, -1, -1, 1, 1, -1, -1])
    up = height * np.array([0, 0, 0, 0, -1, -1, -1, -1])
    across = width / 2 * np.array([1, -1, -1, 1, 1, -1, -1, 1])
    turn = np.array([[np.cos(rotation), 0, np.sin(rotation)], [0, 1, 0], [-np.sin(rotation), 0, np.cos(rotation)]])
    return (turn @ np.stack([along, up, across])).T + np.array([x, y, z])


def test_boxes_images_and_poses(street: Dataset, out: Path) -> None:
    listed = json.loads((out / "sequences.json").read_text())
    sequences = {(item["traversal_id"], item["camera"]): item for item in listed}
    assert len(sequences) == 12
    labels = 0
    for traversal in street.traversals():
        for camera in street.cameras():
            about = sequences[traversal, camera]
            name = about["sequence"]
            calibration = matrices(out / "sequences" / name / "calib.txt")
            times = [float(line) for line in (out / "sequences" / name / "times.txt").read_text().split()]
            poses = np.loadtxt(out / "poses" / f"{name}.txt").reshape(-1, 3, 4)
            lines = [line.split() for line in (out / "label_02" / f"{name}.txt").read_text().splitlines()]
            first = np.array(about["world_SE3_first_camera"])
            for number, frame in enumerate(street.where(traversal=traversal).frames()):
                image = frame.images[camera]
                assert about["first_timestamp_ns"] + round(times[number] * 1e9) == image.timestamp_ns
                pose = first @ np.vstack([poses[number], [0, 0, 0, 1]])
                np.testing.assert_allclose(pose, image.world_SE3_camera.matrix()[0], atol=1e-9)
                lens = image.camera_model if image.camera_model.model == "pinhole" else undistorted(image.camera_model)
                camera_SE3_ego = image.calibration.ego_SE3_camera.inverse().matrix()[0]
                np.testing.assert_allclose(calibration["Tr"], camera_SE3_ego[:3], atol=1e-12)
                pixels = cv2.imread(str(out / "sequences" / name / "image_2" / f"{number:06}.png"))
                assert pixels.shape == (lens.height_px, lens.width_px, 3)
                boxes = frame.boxes(f"camera:{camera}")
                ours = corners(boxes.pose, boxes.size_m)
                tracks = {track: int(key) for key, track in about["tracks"].items()}
                for words in (line for line in lines if int(line[0]) == number):
                    row = [tracks[track] for track in boxes.track_id].index(int(words[1]))
                    assert words[2] == {"van": "Van", "car": "Car"}[boxes.category[row]]
                    theirs = label_corners(words)
                    distance = np.linalg.norm(theirs[:, None] - ours[row][None], axis=-1)
                    assert max(distance.min(axis=0).max(), distance.min(axis=1).max()) < 1e-5
                    homogeneous = calibration["P2"] @ np.column_stack([theirs, np.ones(8)]).T
                    uv = (homogeneous[:2] / homogeneous[2]).T
                    if words[3] == "0":
                        bounds = [*uv.min(axis=0), *uv.max(axis=0)]
                        np.testing.assert_allclose(np.array(words[6:10], float), bounds, atol=1e-3)
                    labels += 1
    assert labels > 60
