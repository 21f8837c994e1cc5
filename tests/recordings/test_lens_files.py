"""Lens files of OpenCV, ROS and Kalibr, and mountings as text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mirror.errors import RecordingError, UsageError
from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.recordings.lens_files import read_lens, write_lens
from mirror.recordings.mounting import parse_mounting

KALIBR = """cam0:
  camera_model: pinhole
  distortion_coeffs: [0.1, 0.2, 0.001, -0.002]
  distortion_model: radtan
  intrinsics: [450.0, 451, 320.5, 240.5]
  resolution: [640, 480]
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, 0.1]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  distortion_coeffs: [0.1, 0.02, 0.001, -0.002]
  distortion_model: equidistant
  intrinsics: [450.0, 451, 320.5, 240.5]
  resolution: [640, 480]
"""
ROS = """image_width: 640
image_height: 480
camera_name: narrow
camera_matrix: {rows: 3, cols: 3, data: [430.1, 0.0, 306.0, 0.0, 430.5, 227.2, 0.0, 0.0, 1.0]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [-0.33, 0.11, -0.001, 0.0, 0.0]}
"""


@pytest.mark.parametrize(
    "lens",
    [
        Camera("pinhole", 640, 480, 400.0, 401.0, 320.25, 239.0),
        Camera("brown_conrady", 640, 480, 400.0, 401.0, 320.25, 239.0, (-0.1, 0.02, 1e-3, -2e-3, 0.01)),
        Camera("rational", 640, 480, 400.0, 401.0, 320.25, 239.0, (-0.1, 0.02, 1e-3, -2e-3, 0.0, 0.1, 0.0, 0.0)),
        Camera("kannala_brandt", 640, 480, 400.0, 401.0, 320.25, 239.0, (0.1, 0.02, 1e-3, -2e-3)),
    ],
)
def test_lenses_survive_a_file(lens: Camera, tmp_path: Path) -> None:
    write_lens(tmp_path / "lens.yaml", lens, {"avg_reprojection_error": 0.3})
    assert read_lens(tmp_path / "lens.yaml") == lens
    with pytest.raises(UsageError):
        write_lens(tmp_path / "odd.yaml", Camera("f_theta", 8, 6, 1.0, 1.0, 4.0, 3.0, (0.0, 5.0)))


def test_files_of_ros_and_kalibr(tmp_path: Path) -> None:
    (tmp_path / "ros.yaml").write_text(ROS)
    assert read_lens(tmp_path / "ros.yaml") == Camera(
        "brown_conrady", 640, 480, 430.1, 430.5, 306.5, 227.7, (-0.33, 0.11, -0.001, 0.0, 0.0)
    )
    (tmp_path / "chain.yaml").write_text(KALIBR)
    second = read_lens(tmp_path / "chain.yaml", "cam1")
    assert second == Camera("kannala_brandt", 640, 480, 450.0, 451.0, 321.0, 241.0, (0.1, 0.02, 0.001, -0.002))
    assert read_lens(tmp_path / "chain.yaml", "cam0").model == "brown_conrady"
    for name in (None, "cam2"):
        with pytest.raises(RecordingError, match="cam0, cam1"):
            read_lens(tmp_path / "chain.yaml", name)


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "no keys"),
        ("\0\1", "YAML"),
        ("%YAML:1.0\n---\nx: [", "YAML"),
        ("a: 1\n", "image_width, image_height, camera_matrix, distortion_coefficients"),
        (ROS.replace("plumb_bob", "thin_prism"), "thin_prism"),
        (ROS.replace("430.1, 0.0,", "430.1, 2.0,"), "skew"),
        (ROS.replace("430.1,", "0.0,"), "fx, fy > 0"),
        (KALIBR.replace("pinhole", "omni"), "omni"),
        (KALIBR.replace("resolution: [640, 480]", "resolution: [640]"), "cam0.resolution"),
    ],
)
def test_other_files_are_refused(text: str, named: str, tmp_path: Path) -> None:
    (tmp_path / "lens.yaml").write_text(text)
    with pytest.raises(RecordingError, match=named):
        read_lens(tmp_path / "lens.yaml", "cam0" if text.startswith("cam0") else None)


def test_mountings_as_text() -> None:
    def axes(text: str) -> np.ndarray:
        numbers = np.array([parse_mounting(text, "--mounting")])
        return np.round(Poses(numbers[:, :4], np.zeros((1, 3))).transform(np.eye(3))[0], 9)

    # Rows: where the image's x, y and viewing direction point, in x forward, y left, z up.
    np.testing.assert_allclose(axes("1,2,3,0,0,0"), [[0, -1, 0], [0, 0, -1], [1, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(axes("0,0,0,0,0,90")[2], [0, 1, 0], atol=1e-9)
    np.testing.assert_allclose(axes("0,0,0,0,30,0")[2], [np.sqrt(0.75), 0, -0.5], atol=1e-9)
    np.testing.assert_allclose(axes("0,0,0,90,0,0")[1], [0, 1, 0], atol=1e-9)
    assert parse_mounting("1,2,3,0,0,0", "--mounting")[4:] == (1.0, 2.0, 3.0)
    assert parse_mounting("0.5,-0.5,0.5,-0.5,1,2,3", "") == pytest.approx(parse_mounting("1,2,3,0,0,0", ""))
    for wrong in ("1,2,3", "a,b,c,d,e,f", "1,2,3,0,0,nan", "2,0,0,0,1,1,1"):
        with pytest.raises(UsageError):
            parse_mounting(wrong, "--mounting")
