"""Intrinsics of rendered boards against the exact lens, and of real images."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.calibration.chessboard import calibrate_chessboard
from mirror.errors import UsageError
from mirror.geometry import Poses, quaternion_exp
from mirror.geometry.cameras import Camera

PATTERN = (9, 6)
LENS = Camera("brown_conrady", 480, 360, 400.0, 402.0, 243.0, 178.0, (-0.12, 0.05, 0.0004, -0.0003, 0.0))


def view(turn: tuple[float, float, float], place: tuple[float, float, float]) -> np.ndarray:
    """A board of squares of side 1 whose first inner corner is at the origin, seen through the lens."""
    pose = Poses(quaternion_exp(np.array([turn])), np.array([place]))
    offsets = (np.arange(2) + 0.5) / 2.0 - 0.5
    total = np.zeros((360, 480))
    for dy in offsets:
        for dx in offsets:
            u, v = np.meshgrid(np.arange(480) + 0.5 + dx, np.arange(360) + 0.5 + dy)
            rays = LENS.unproject(np.stack([u, v], axis=-1).reshape(-1, 2)).direction
            back = pose.inverse()
            origin, ends = back.transform(np.zeros((1, 3)))[0], back.transform(rays)[0]
            way = ends - origin
            at = (origin - way * (origin[0, 2] / way[:, 2:]))[:, :2]
            inside = (at > -1.0).all(axis=1) & (at < np.array(PATTERN)).all(axis=1)
            dark = inside & (np.floor(at).sum(axis=1) % 2 == 0)
            total += np.where(dark, 30.0, 220.0).reshape(360, 480)
    return np.round(total / 4.0).astype(np.uint8)


def test_rendered_boards_give_the_exact_lens() -> None:
    turns = [
        (0.3, 0.2, 0.0),
        (-0.35, 0.25, 0.1),
        (0.4, -0.3, -0.1),
        (-0.3, -0.4, 0.05),
        (0.1, 0.45, 0.2),
        (0.45, 0.0, 0),
    ]
    images = [view(turn, (-4.0, -2.5, 12.0 + 0.5 * number)) for number, turn in enumerate(turns)]
    blank = np.full((360, 480), 128, np.uint8)
    found = calibrate_chessboard([*images, blank, images[0][:300]], PATTERN)
    assert found.used == tuple(range(6))
    assert set(found.rejected) == {6, 7}
    assert found.rms_px < 0.2
    assert found.camera.fx_px == pytest.approx(LENS.fx_px, abs=2.0)
    assert found.camera.fy_px == pytest.approx(LENS.fy_px, abs=2.0)
    # Half a pixel of convention would show here.
    assert found.camera.cx_px == pytest.approx(LENS.cx_px, abs=max(0.35, 3.0 * found.sigma_px[2]))
    assert found.camera.cy_px == pytest.approx(LENS.cy_px, abs=max(0.35, 3.0 * found.sigma_px[3]))


def test_too_few_boards_are_refused() -> None:
    with pytest.raises(UsageError, match="0 of 2 images"):
        calibrate_chessboard([np.full((60, 80), 128, np.uint8)] * 2, PATTERN)
    with pytest.raises(UsageError, match="0 of 0"):
        calibrate_chessboard([], PATTERN)


@pytest.mark.real_data
def test_real_images(real_data: Path) -> None:
    images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted((real_data / "chessboard").glob("*.jpg"))]
    found = calibrate_chessboard(images, PATTERN)
    assert len(found.used) >= 8
    assert found.rms_px < 1.5
    assert 0.5 < found.camera.fx_px / found.camera.width_px < 2.0
    assert abs(found.camera.fy_px / found.camera.fx_px - 1.0) < 0.02
