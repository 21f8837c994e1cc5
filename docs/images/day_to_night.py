"""The moving image of the README: ``python docs/images/day_to_night.py DATASET MODEL TRAVERSAL [OUT]``.

Run it after ``make demo``, on the dataset and the model of its block.
Left: recorded. Middle: the reconstruction from 2 m to the left. Right: the same, with the appearance of the night.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from PIL import Image, ImageDraw

import mirror
from mirror.arrays import UInt8
from mirror.cli.main import main as mirror_command

CAMERA = "front_wide"
WIDTH_PX = 288
EVERY = 3
TITLES = ("recorded by day", "reconstructed, 2 m to the left", "the same at night")


def frames_of(video: Path) -> list[UInt8]:
    """Return all frames of a video, RGB."""
    capture, frames = cv2.VideoCapture(str(video)), []
    while True:
        ok, frame = capture.read()
        if not ok:
            return frames
        frames.append(np.asarray(frame[..., ::-1], np.uint8))


def to_size(image: UInt8, width_px: int, height_px: int) -> UInt8:
    """Scale an image to a width and cut the same from its top and bottom."""
    scaled = cv2.resize(
        image, (width_px, round(width_px * image.shape[0] / image.shape[1])), interpolation=cv2.INTER_AREA
    )
    top = max(0, (scaled.shape[0] - height_px) // 2)
    return np.asarray(scaled[top : top + height_px], np.uint8)


def main(dataset: str, model: str, traversal: str, out: str = "docs/images/day_to_night.webp") -> None:
    """Render, compose and write the image."""
    rendered = []
    with tempfile.TemporaryDirectory() as folder:
        for number, appearance in enumerate((traversal, "night")):
            video = Path(folder) / f"{number}.mp4"
            where = [
                "--trajectory",
                "lane-shift:2.0",
                "--traversal",
                traversal,
                "--cameras",
                CAMERA,
            ]
            code = mirror_command(["render", dataset, model, *where, "--appearance", appearance, "--out", str(video)])
            if code:
                sys.exit(code)
            rendered.append(frames_of(video))
    recorded = mirror.open(dataset).where(traversal=traversal, camera=CAMERA).frames()
    height = round(WIDTH_PX * rendered[0][0].shape[0] / rendered[0][0].shape[1])
    pages = []
    for number in range(0, len(rendered[0]), EVERY):
        image = recorded[number * len(recorded) // len(rendered[0])].images[CAMERA]
        panels = [
            to_size(panel_image, WIDTH_PX, height)
            for panel_image in (image.decode(), rendered[0][number], rendered[1][number])
        ]
        page = Image.new("RGB", (3 * WIDTH_PX + 8, height), "white")
        for column, (panel, title) in enumerate(zip(panels, TITLES)):
            page.paste(Image.fromarray(panel), (column * (WIDTH_PX + 4), 0))
            ImageDraw.Draw(page).text(
                (column * (WIDTH_PX + 4) + 6, height - 16), title, fill="white", stroke_width=1, stroke_fill="black"
            )
        pages.append(page)
    pages[0].save(out, save_all=True, append_images=pages[1:], duration=100, loop=0, quality=70, method=6)
    print(out)


if __name__ == "__main__":
    main(*sys.argv[1:])
