"""Backgrounds without plates: synthetic streets, photographs of packages, and textures with text and slats."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from mirror.arrays import UInt8

WIDTH_PX: Final = 1280
HEIGHT_PX: Final = 720
_CONDITIONS: Final = (("day", "clear"), ("night", "clear"), ("dusk", "clear"), ("day", "rain"))
_PLACE: Final = (8.41694, 49.01252)
_PHOTOS: Final = (
    "astronaut",
    "brick",
    "coffee",
    "chelsea",
    "grass",
    "gravel",
    "rocket",
    "camera",
    "coins",
    "page",
    "text",
)


def render_streets(count: int, seed: int) -> Iterator[UInt8]:
    """Yield images (720, 1280, 3), RGB, of synthetic streets, whose own plates are painted over.

    Args:
        count: number of images; a street serves eight of them.
        seed: seed of the streets and of what stands in them.
    """
    from benchmarks.synth_detectors.crowd import make_condition, render_crowds
    from mirror.schema.documents import Roi
    from mirror.synth.street.world import build_world

    for first in range(0, count, 8):
        roi = Roi(
            scene_id=f"plates{seed}-{first}", longitude_deg=_PLACE[0], latitude_deg=_PLACE[1], radius_m=100.0,
            city="Karlsruhe", scene_type="urban", height_m=115.0,
        )  # fmt: skip
        world = build_world(roi, 24.0, seed + first)
        for number in range(first, min(first + 8, count)):
            condition = make_condition(*_CONDITIONS[number % len(_CONDITIONS)])
            images = render_crowds(
                world, condition, 2, WIDTH_PX, seed + number, people=(3, 1), cars=(3, 5), left_out={0}
            )
            image = next(images if number % 8 else render_crowds(world, condition, 1, WIDTH_PX, seed + number))
            hidden = np.zeros(image.bgr.shape[:2], np.uint8)
            for plate in image.plates:
                left, top, right, bottom = (plate.box_px + np.array([-3, -3, 3, 3])).round().astype(int)
                hidden[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)] = 255
            clean = cv2.inpaint(image.bgr, hidden, 3, cv2.INPAINT_TELEA)
            yield np.ascontiguousarray(clean[..., ::-1])


def photographs() -> list[UInt8]:
    """Photographs (H, W, 3), RGB, that are parts of scikit-image; none shows a plate."""
    import skimage.data

    folder = Path(str(skimage.data.__file__)).parent
    images = [cv2.imread(str(folder / f"{name}.png")) for name in _PHOTOS if (folder / f"{name}.png").is_file()]
    images.append(cv2.imread(str(folder / "rocket.jpg")))
    return [np.ascontiguousarray(image[..., ::-1]) for image in images if image is not None]


def save_backgrounds(path: Path, images: Sequence[UInt8]) -> None:
    """Write images to a file, as JPEG."""
    coded = [cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])[1] for image in images]
    np.savez(path, **{f"{number:04d}": one for number, one in enumerate(coded)})  # type: ignore[arg-type]


def load_backgrounds(path: Path) -> list[UInt8]:
    """Read images (H, W, 3), RGB, from a file."""
    with np.load(path) as stored:
        images = [np.asarray(cv2.imdecode(stored[key], cv2.IMREAD_COLOR)) for key in sorted(stored.files)]
    return [np.ascontiguousarray(image[..., ::-1], np.uint8) for image in images]
