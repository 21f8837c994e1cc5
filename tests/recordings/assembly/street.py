"""A drive between two painted walls, filmed by one camera: the inputs that a person without a recorder has."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

from mirror.calibration.boards import CalibrationBoard
from mirror.geometry.cameras import Camera
from tests.calibration.boards import TURNS, view

START_NS = 1_772_359_200_000_000_000
LONGITUDE, LATITUDE = 13.4, 52.5
SPEED_MPS, SECONDS, HZ = 3.0, 12.0, 2
HEIGHT_M = 1.4
LENS = Camera("brown_conrady", 320, 240, 260.0, 260.0, 161.0, 119.0, (-0.08, 0.02, 0.0, 0.0, 0.0))


def write_boards(folder: Path) -> Path:
    """Twelve images of a chessboard."""
    folder.mkdir()
    for number in range(12):
        turn = np.array(TURNS[number % 6]) * (1.0 if number < 6 else -1.0)
        place = (-4.0 + (number % 3 - 1) * 2.0, -2.5 + (number // 3 - 1.5) * 1.2, 12.0 + 0.3 * number)
        cv2.imwrite(str(folder / f"{number:02}.png"), view(LENS, CalibrationBoard(9, 6), tuple(turn), place))
    return folder


def paint(across: np.ndarray, along: np.ndarray, seed: int) -> np.ndarray:
    """Colours (..., 3) of a surface: patches of 0.5 m in random colours, bilinear."""
    colours = np.random.default_rng(seed).integers(30, 225, (64, 128, 3)).astype(np.float32)
    x, y = ((np.asarray(values) * 2.0).astype(np.float32) for values in (along, across))
    return cv2.remap(colours, x % 127, y % 63, cv2.INTER_LINEAR)


def image_at(x_m: float, left_m: float) -> np.ndarray:
    """The street (H, W, 3) BGR from a camera that looks along x, 1.4 m above the ground."""
    u, v = np.meshgrid(np.arange(LENS.width_px) + 0.5, np.arange(LENS.height_px) + 0.5)
    rays = LENS.unproject(np.stack([u, v], axis=-1).reshape(-1, 2)).direction.reshape(*u.shape, 3)
    right, down, forward = rays[..., 0], rays[..., 1], rays[..., 2]
    with np.errstate(divide="ignore"):
        wall = np.where(right > 0, 5.0 + left_m, 5.0 - left_m) / np.abs(right)
        ground = np.where(down > 0, HEIGHT_M / down, np.inf)
    end = (80.0 - x_m) / forward
    depth = np.minimum(np.minimum(wall, ground), end)
    point = rays * depth[..., None]
    along, side, height = point[..., 2] + x_m, point[..., 0] - left_m, HEIGHT_M - point[..., 1]
    colour = np.where((depth == ground)[..., None], paint(side + 20.0, along, 3), paint(height + 90.0, along, 1))
    colour = np.where((depth == wall)[..., None] & (right > 0)[..., None], paint(height + 90.0, along, 2), colour)
    return np.where((depth == end)[..., None], paint(height + 90.0, side + 60.0, 4), colour).astype(np.uint8)


def write_film(file: Path, left_m: float = 0.0) -> Path:
    """The drive as H.264."""
    with av.open(str(file), "w") as container:
        stream = container.add_stream("libx264", rate=HZ)
        stream.width, stream.height, stream.pix_fmt = LENS.width_px, LENS.height_px, "yuv420p"
        stream.options = {"crf": "10"}
        stream.codec_context.time_base = Fraction(1, HZ)
        for index in range(int(SECONDS * HZ) - 1):
            bgr = image_at((index / HZ + 0.25) * SPEED_MPS, left_m)
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(bgr[..., ::-1]), format="rgb24")
            frame.pts, frame.time_base = index, Fraction(1, HZ)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return file


def write_track(file: Path, *, heading: bool = True, start_ns: int = START_NS, left_m: float = 0.0) -> Path:
    """Poses at 10 Hz to the east, 0.2 s late, with the ego on the ground below the camera."""
    latitude = LATITUDE + left_m / 111_268.0
    lines = ["timestamp_ns,longitude_deg,latitude_deg,height_m" + (",heading_deg" if heading else "")]
    for step in range(int(SECONDS * 10)):
        # One degree of longitude on the ellipsoid there.
        longitude = LONGITUDE + step / 10 * SPEED_MPS / 67_905.0
        lines.append(f"{start_ns + step * 100_000_000},{longitude:.10f},{latitude:.10f},0" + (",90" if heading else ""))
    file.write_text("\n".join(lines) + "\n")
    return file
