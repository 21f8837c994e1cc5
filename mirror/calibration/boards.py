"""Calibration boards, and their corners in an image: a chessboard, or a ChArUco board (chessboard with markers)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from mirror.arrays import Float32, Float64, UInt8
from mirror.errors import UsageError

BoardKind = Literal["chessboard", "charuco"]
_FEWEST_CORNERS: Final = 6
_LARGEST_SIDE: Final = 100
# Half the side of the window in which a corner is refined, pixels.
_WINDOW: Final = (7, 7)


@dataclass(frozen=True)
class CalibrationBoard:
    """A flat board of squares of side 1.

    The side of the squares does not matter for a lens: it scales the distances of the boards alone.

    Attributes:
        columns: number of inner corners along the longer side.
        rows: number of inner corners along the other side.
        kind: with or without markers in its white squares.
        dictionary: the markers, as OpenCV calls them, such as ``DICT_5X5_100`` (ChArUco).
        marker: side of a marker as a part of the side of a square (ChArUco).

    Raises:
        UsageError: a number makes no board, or OpenCV has no such dictionary.
    """

    columns: int
    rows: int
    kind: BoardKind = "chessboard"
    dictionary: str = "DICT_5X5_100"
    marker: float = 0.75

    def __post_init__(self) -> None:
        import cv2

        if not (2 <= self.columns <= _LARGEST_SIDE and 2 <= self.rows <= _LARGEST_SIDE):
            raise UsageError(
                f"a board of {self.columns} x {self.rows} inner corners", place="--board",
                expected=f"2 to {_LARGEST_SIDE} inner corners along each side, such as 9x6",
            )  # fmt: skip
        if not 0 < self.marker < 1:
            raise UsageError(f"a marker of {self.marker:g} squares", place="--marker", expected="more than 0, below 1")
        if self.kind == "charuco" and not (self.dictionary.startswith("DICT_") and hasattr(cv2.aruco, self.dictionary)):
            known = sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_"))
            raise UsageError(
                f"there is no dictionary {self.dictionary!r}", place="--dictionary",
                expected=f"one of {', '.join(known)}",
            )  # fmt: skip

    @property
    def corners(self) -> Float32:
        """(columns * rows, 3) inner corners on the board, row by row, with z = 0."""
        grid = np.zeros((self.columns * self.rows, 3), np.float32)
        grid[:, :2] = np.mgrid[: self.columns, : self.rows].T.reshape(-1, 2)
        return grid


@dataclass(frozen=True, eq=False)
class BoardView:
    """The corners of a board that an image shows.

    Attributes:
        points: (N, 3) on the board, in sides of a square, z = 0.
        pixels: (N, 2) in the image; the centre of the first pixel is at 0, as OpenCV has it.
    """

    points: Float32
    pixels: Float32


def find_board(image: UInt8, board: CalibrationBoard) -> BoardView | str:
    """Return the corners of the board in an (H, W) grey image, or the reason why none were found."""
    return _find_charuco(image, board) if board.kind == "charuco" else _find_chessboard(image, board)


def find_size(image: UInt8) -> tuple[int, int] | None:
    """Return the numbers of inner corners of the chessboard that an (H, W) grey image shows, the larger first.

    None: no board.

    The detector of Duda and Frese ("Accurate Detection and Localization of Checkerboard Corners for Calibration", 2018)
    grows a board from 3 x 3 corners.
    """
    import cv2

    complete, _, meta = cv2.findChessboardCornersSBWithMeta(image, (3, 3), cv2.CALIB_CB_LARGER)
    if not complete or meta is None:
        return None
    first, second = meta.shape[:2]
    return max(first, second), min(first, second)


def _find_chessboard(image: UInt8, board: CalibrationBoard) -> BoardView | str:
    import cv2

    pattern = (board.columns, board.rows)
    complete, found = cv2.findChessboardCorners(image, pattern)
    if complete:
        done = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 1e-3)
        found = cv2.cornerSubPix(image, found, _WINDOW, (-1, -1), done)
    else:
        complete, found = cv2.findChessboardCornersSB(image, pattern)
    if not complete:
        return f"no complete board of {board.columns} x {board.rows} inner corners"
    return BoardView(board.corners, np.asarray(found, np.float32).reshape(-1, 2))


def _find_charuco(image: UInt8, board: CalibrationBoard) -> BoardView | str:
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    most = 0
    # Until version 4.6 OpenCV drew boards with an even number of rows in the other order of colours.
    for legacy in (False, True):
        charuco = cv2.aruco.CharucoBoard((board.columns + 1, board.rows + 1), 1.0, board.marker, dictionary)
        charuco.setLegacyPattern(legacy)
        pixels, ids, _, markers = cv2.aruco.CharucoDetector(charuco).detectBoard(image)
        known = len(charuco.getIds())
        if markers is not None and len(markers) and int(np.max(markers)) >= known:
            return f"a marker with the number {int(np.max(markers))}; the board has the numbers 0 to {known - 1}"
        most = max(most, 0 if ids is None else len(ids))
        if ids is None or len(ids) < _FEWEST_CORNERS or charuco.checkCharucoCornersCollinear(ids):
            continue
        points = np.asarray(charuco.getChessboardCorners(), np.float32)[ids.ravel()]
        return BoardView(points, np.asarray(pixels, np.float32).reshape(-1, 2))
    return f"{most} corners with markers of {board.dictionary}; at least {_FEWEST_CORNERS} off one line are needed"


def board_normal(rotation_vector: Float64) -> Float64:
    """Return the normal (3,) of a board in the camera frame, from its rotation vector (3,)."""
    import cv2

    matrix = np.asarray(cv2.Rodrigues(rotation_vector.reshape(3, 1))[0], np.float64)
    return np.asarray(matrix[:, 2], np.float64)
