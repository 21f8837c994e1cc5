"""Images of calibration boards, traced through a lens."""

from __future__ import annotations

import cv2
import numpy as np

from mirror.calibration.boards import CalibrationBoard
from mirror.geometry import Poses, quaternion_exp
from mirror.geometry.cameras import Camera

TURNS = [
    (0.3, 0.2, 0.0), (-0.35, 0.25, 0.1), (0.4, -0.3, -0.1), (-0.3, -0.4, 0.05), (0.1, 0.45, 0.2), (0.45, 0.0, 0.0),
]  # fmt: skip


def draw_board(board: CalibrationBoard, square_px: int = 40) -> np.ndarray:
    """The board as printed, with a white margin of one square."""
    size = (board.columns + 1, board.rows + 1)
    if board.kind == "charuco":
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        drawn = cv2.aruco.CharucoBoard(size, 1.0, board.marker, dictionary)
        inner = drawn.generateImage((size[0] * square_px, size[1] * square_px))
    else:
        cells = np.add.outer(np.arange(size[1]), np.arange(size[0])) % 2
        inner = np.kron(np.where(cells == 0, 30, 220), np.ones((square_px, square_px))).astype(np.uint8)
    return np.pad(inner, square_px, constant_values=235)


def view(lens: Camera, board: CalibrationBoard, turn: tuple[float, ...], place: tuple[float, ...]) -> np.ndarray:
    """The board, whose first inner corner is at the origin, seen through the lens: every ray is traced."""
    printed, square_px = draw_board(board), 40
    inverse = Poses(quaternion_exp(np.array([turn])), np.array([place])).inverse()
    offsets = (np.arange(2) + 0.5) / 2.0 - 0.5
    total = np.zeros((lens.height_px, lens.width_px))
    for dy in offsets:
        for dx in offsets:
            u, v = np.meshgrid(np.arange(lens.width_px) + 0.5 + dx, np.arange(lens.height_px) + 0.5 + dy)
            rays = lens.unproject(np.stack([u, v], axis=-1).reshape(-1, 2)).direction
            origin, ends = inverse.transform(np.zeros((1, 3)))[0], inverse.transform(rays)[0]
            way = ends - origin
            at = (origin - way * (origin[0, 2] / way[:, 2:]))[:, :2]
            # The print has one square of margin and one outer square before the first inner corner.
            pixel = np.nan_to_num((at + 2.0) * square_px - 0.5, nan=-1e4).clip(-1e4, 1e4).astype(np.float32)
            x, y = (pixel[:, axis].reshape(total.shape) for axis in (0, 1))
            total += cv2.remap(printed, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=150)
    return np.round(total / 4.0).astype(np.uint8)
