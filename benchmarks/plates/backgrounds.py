"""Backgrounds without plates: synthetic streets, photographs of packages, and textures with text and slats."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np

from mirror.arrays import AnyArray, Float64, UInt8

WIDTH_PX: Final = 1280
HEIGHT_PX: Final = 720
_CONDITIONS: Final = (("day", "clear"), ("night", "clear"), ("dusk", "clear"), ("day", "rain"))
_PLACE: Final = (8.41694, 49.01252)
_PHOTOS: Final = (
    "astronaut.png", "brick.png", "coffee.png", "chelsea.png", "grass.png", "gravel.png", "rocket.jpg", "camera.png",
    "coins.png", "page.png", "text.png",
)  # fmt: skip
_IN_VIEW: Final = 0.85


@dataclass(frozen=True, eq=False)
class Background:
    """An image without plates, in front of which plates are drawn.

    Attributes:
        image: (H, W, 3) RGB.
        places_px: (N, 4) left, top, right and bottom of where vehicles bear a plate, in full view; it is painted over.
    """

    image: UInt8
    places_px: Float64


def render_streets(count: int, seed: int) -> Iterator[Background]:
    """Yield images (720, 1280, 3) of synthetic streets, whose own plates are painted over.

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
            # One image of eight shows a crowd; the others show people and cars.
            placed: dict[str, Any] = {} if number % 8 == 0 else {"people": (3, 3), "cars": (5, 5)}
            image = next(render_crowds(world, condition, 1, WIDTH_PX, seed + number, **placed))
            hidden = np.zeros(image.bgr.shape[:2], np.uint8)
            for plate in image.plates:
                left, top, right, bottom = (plate.box_px + np.array([-3, -3, 3, 3])).round().astype(int)
                hidden[max(top, 0) : max(bottom, 0), max(left, 0) : max(right, 0)] = 255
            clean = np.asarray(cv2.inpaint(image.bgr, hidden, 3, cv2.INPAINT_TELEA), np.uint8)
            places = [plate.box_px for plate in image.plates if plate.seen > _IN_VIEW]
            yield Background(np.ascontiguousarray(clean[..., ::-1]), np.array(places, np.float64).reshape(-1, 4))


def photographs() -> list[Background]:
    """Return the photographs that are parts of scikit-image; none shows a plate."""
    import skimage.data

    folder = Path(str(skimage.data.__file__)).parent
    files = [folder / name for name in _PHOTOS]
    images = [cv2.imread(str(file)) for file in files if file.is_file()]
    return [
        Background(np.ascontiguousarray(image[..., ::-1], np.uint8), np.zeros((0, 4)))
        for image in images
        if image is not None
    ]


def save_backgrounds(path: Path, backgrounds: Sequence[Background], quality: int = 92) -> None:
    """Write images to a file, as JPEG, with the places of plates."""
    stored: dict[str, AnyArray] = {}
    for number, one in enumerate(backgrounds):
        coded = np.asarray(cv2.imencode(".jpg", one.image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1])
        stored |= {f"image{number:04d}": coded, f"places{number:04d}": one.places_px}
    np.savez(path, **stored)  # type: ignore[arg-type]


def load_backgrounds(path: Path) -> list[Background]:
    """Read images from a file."""
    found = []
    with np.load(path) as stored:
        for name in sorted(name for name in stored.files if name.startswith("image")):
            image = np.asarray(cv2.imdecode(stored[name], cv2.IMREAD_COLOR))
            places = stored[name.replace("image", "places")]
            found.append(Background(np.ascontiguousarray(image[..., ::-1], np.uint8), places))
    return found
