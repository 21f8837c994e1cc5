"""The test set: images of 1280 x 720 with plates whose designs, typefaces and dirt no training has."""

from __future__ import annotations

from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmarks.plates.backgrounds import HEIGHT_PX, WIDTH_PX, Background
from benchmarks.plates.camera import blur, make_night, record, shade, splash
from benchmarks.plates.designs import HELD_OUT, Design
from benchmarks.plates.drawing import draw_panel, draw_plate
from benchmarks.plates.fonts import Glyphs
from benchmarks.plates.geometry import FOCAL, Stance, bounds, paste, place_corners
from mirror.arrays import Float64, UInt8

SEED: Final = 4711
EDGES_PX: Final = (20.0, 32.0, 64.0, 96.0, 128.0, 192.0, 320.0, 500.0)
_YAW_DEG: Final = 30.0


@dataclass(frozen=True, eq=False)
class HeldOutImage:
    """An image of the test.

    Attributes:
        number: index in the set.
        image: (720, 1280, 3) RGB.
        corners: (N, 4, 2) corners of its plates.
        designs: family of each plate.
        light: `day` or `night`.
    """

    number: int
    image: UInt8
    corners: Float64
    designs: tuple[str, ...]
    light: str

    @property
    def boxes_px(self) -> Float64:
        """(N, 4) left, top, right and bottom of the plates."""
        return np.concatenate([self.corners.min(axis=1), self.corners.max(axis=1)], axis=1)


def draw_held_out(
    count: int,
    backgrounds: Sequence[Background],
    glyphs: Glyphs,
    *,
    designs: Sequence[Design] = HELD_OUT,
    edges_px: Sequence[float] = EDGES_PX,
    seed: int = SEED,
    left_out: Container[int] = (),
) -> Iterator[HeldOutImage]:
    """Yield images with one to three plates of 20 to 500 px, each span of widths as often as the others.

    Args:
        count: number of images.
        backgrounds: images of 1280 x 720 pixels without plates.
        glyphs: masks of the characters.
        designs: the designs.
        edges_px: the limits of the spans of widths.
        seed: seed of all that is drawn.
        left_out: indices of images that are not drawn; the others stay the same.
    """
    for number in (number for number in range(count) if number not in left_out):
        rng = np.random.default_rng([seed, number])
        image = backgrounds[number % len(backgrounds)].image.copy()
        if rng.random() < 0.5:
            image = np.ascontiguousarray(image[:, ::-1])
        is_night = number % 4 == 3
        image = make_night(image, rng) if is_night else image
        boxes: list[Float64] = []
        corners, names = [], []
        for place in range(int(rng.integers(1, 4))):
            span = (2 * number + 3 * place) % (len(edges_px) - 1)
            width = float(np.exp(rng.uniform(*np.log(edges_px[span : span + 2]))))
            design = designs[int(rng.integers(len(designs)))]
            found = _paste(image, design, width, glyphs, rng, boxes, is_night)
            if found is not None:
                corners.append(found)
                names.append(design.name)
        image = shade(image, rng)
        if rng.random() < 0.5:
            least = min((float(np.ptp(one[:, 1])) for one in corners), default=30.0)
            image = blur(image, rng, float(np.clip(0.05 * least, 0.35, 2.5)))
        image = record(image, rng, rng.uniform(0.5, 5.0), int(rng.integers(55, 96)))
        shown = np.array(corners, np.float64).reshape(-1, 4, 2)
        yield HeldOutImage(number, image, shown, tuple(names), "night" if is_night else "day")


def _paste(
    image: UInt8, design: Design, width: float, glyphs: Glyphs, rng: np.random.Generator, boxes: list[Float64],
    is_night: bool,
) -> Float64 | None:  # fmt: skip
    """Paste a plate where none is; return its corners, or None without room."""
    plate = draw_plate(design, glyphs, max(1.1 * width, 80.0) / design.size_mm[0], rng, strict=True)
    if rng.random() < 0.35:
        plate = splash(plate, rng, int(rng.integers(5, 40)))
    panel = draw_panel(plate, rng, bare=rng.random() < 0.1, framed=rng.random() < 0.5, glyphs=glyphs)
    reach = max(panel.alpha.shape) / plate.shape[1]
    turn = rng.uniform(-1.0, 1.0, 3) * (_YAW_DEG, 10.0, 6.0)
    for _ in range(20):
        centre = (rng.uniform(0.5 * width, WIDTH_PX - 0.5 * width), rng.uniform(0.2, 0.95) * HEIGHT_PX)
        stance = Stance(width, centre, *turn.tolist())
        corners = place_corners(stance, plate.shape[1] / plate.shape[0], FOCAL * WIDTH_PX, reach)
        box, seen = bounds(corners, WIDTH_PX, HEIGHT_PX)
        apart = 2.2 * np.maximum(box[2:] - box[:2], 20.0)
        if seen > 0.999 and all(_is_clear(box, other, apart) for other in boxes):
            break
    else:
        return None
    gain = rng.uniform(0.6, 1.1) * rng.normal(1.0, 0.03, 3)
    lit = rng.uniform(0.85, 1.2)
    if is_night:
        gain, lit = 0.3 * gain, rng.uniform(1.5, 4.0)
    # The panel covers a part of the street only; earlier plates keep their pixels.
    before = image.copy()
    paste(image, panel, corners, gain.astype(np.float32), float(lit))
    for left, top, right, bottom in (one.round().astype(int) for one in boxes):
        image[top - 2 : bottom + 3, max(left - 2, 0) : right + 3] = before[
            top - 2 : bottom + 3, max(left - 2, 0) : right + 3
        ]
    boxes.append(box)
    return corners


def _is_clear(box: Float64, other: Float64, apart: Float64) -> bool:
    gap = np.maximum(box[:2] - other[2:], other[:2] - box[2:])
    return bool((gap > 0.1 * apart).any())
