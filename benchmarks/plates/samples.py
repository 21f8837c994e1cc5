"""Images of the training: plates of varied designs on parts of vehicles, among things that look like plates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from benchmarks.plates.backgrounds import Background
from benchmarks.plates.camera import blur, make_night, record, shade, soil
from benchmarks.plates.clutter import draw_clutter, draw_foliage, draw_specks
from benchmarks.plates.designs import FAMILIES, vary
from benchmarks.plates.drawing import draw_panel, draw_plate
from benchmarks.plates.fonts import Glyphs
from benchmarks.plates.geometry import Stance, bounds, paste, place_corners
from mirror.arrays import Bool, Float32, Float64, UInt8

SIDE_PX: Final = 640
_FOCAL_PX: Final = 914.0
_WIDTHS_PX: Final = (11.0, 640.0)
_LEAST_PX: Final = 13.0
"""Narrower plates are neither sought nor refused."""
_LEAST_SEEN: Final = 0.6


@dataclass(frozen=True, eq=False)
class Sample:
    """An image of the training.

    Attributes:
        image: (S, S, 3) RGB.
        boxes: (N, 4) left, top, right and bottom of plates.
        ignored: (N,) boxes that are neither sought nor refused: too small, or too little in the image.
    """

    image: UInt8
    boxes: Float32
    ignored: Bool


def draw_sample(
    glyphs: Glyphs, backgrounds: Sequence[Background], rng: np.random.Generator, side_px: int = SIDE_PX
) -> Sample:
    """Draw an image with up to five plates.

    Args:
        glyphs: masks of characters.
        backgrounds: images without plates.
        rng: draws all.
        side_px: side of the image.
    """
    image, places = _background(backgrounds, rng, side_px)
    is_night = rng.random() < 0.25
    if is_night:
        image = make_night(image, rng)
    if rng.random() < 0.25:
        draw_foliage(image, rng)
    if rng.random() < 0.3:
        draw_specks(image, rng)
    boxes, ignored, taken = [], [], np.zeros((side_px, side_px), np.bool_)
    for _ in range(int(rng.integers(0, 7))):
        _paste_clutter(image, glyphs, rng, 0.3 if is_night and rng.random() < 0.7 else 1.0)
    mounted = [_mount(image, place, glyphs, rng, taken, is_night) for place in places if rng.random() < 0.8]
    count = int(rng.choice(6, p=[0.14, 0.36, 0.24, 0.14, 0.08, 0.04])) - min(len(mounted), 2)
    pasted = [_paste_plate(image, glyphs, rng, taken, is_night) for _ in range(count)]
    for found in (*mounted, *pasted):
        if found is not None:
            boxes.append(found[0])
            ignored.append(found[1])
    if rng.random() < 0.8:
        image = shade(image, rng)
    if rng.random() < 0.5:
        largest = max((box[3] - box[1] for box in boxes), default=30.0)
        smallest = min((box[3] - box[1] for box in boxes), default=30.0)
        image = blur(image, rng, float(np.clip(0.06 * smallest + 0.02 * largest, 0.4, 5.0)))
    elif rng.random() < 0.6:
        image = np.asarray(cv2.GaussianBlur(image, (0, 0), rng.uniform(0.35, 0.9)), np.uint8)
    quality = int(rng.integers(35, 97))
    image = record(image, rng, float(abs(rng.normal(0.0, 4.0 if not is_night else 7.0))), quality)
    if rng.random() < 0.06:
        image = np.repeat(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[..., None], 3, axis=-1)
    return Sample(image, np.array(boxes, np.float32).reshape(-1, 4), np.array(ignored, np.bool_))


def _background(backgrounds: Sequence[Background], rng: np.random.Generator, side: int) -> tuple[UInt8, Float64]:
    """Cut a square of a background at some scale, with the places of plates in it; sometimes a texture of noise."""
    nowhere = np.zeros((0, 4))
    if rng.random() < 0.06:
        cells = int(rng.integers(2, 40))
        noise = rng.integers(0, 256, (cells, cells, 3)).astype(np.uint8)
        return np.asarray(cv2.resize(noise, (side, side), interpolation=int(rng.integers(0, 3))), np.uint8), nowhere
    source = backgrounds[int(rng.integers(len(backgrounds)))]
    high, wide = source.image.shape[:2]
    part = min(int(side / np.exp(rng.uniform(np.log(0.55), np.log(2.5)))), high, wide)
    v, u = int(rng.integers(0, high - part + 1)), int(rng.integers(0, wide - part + 1))
    if len(source.places_px) and rng.random() < 0.7:
        left, top, right, bottom = source.places_px[int(rng.integers(len(source.places_px)))]
        u, v = (int(np.clip(rng.uniform(high_ - part, low), 0, limit - part)) for low, high_, limit in (
            (left, right, wide), (top, bottom, high)))  # fmt: skip
    cut = source.image[v : v + part, u : u + part]
    method = cv2.INTER_AREA if part > side else cv2.INTER_LINEAR
    image = np.asarray(cv2.resize(cut, (side, side), interpolation=method), np.uint8)
    places = (source.places_px - [u, v, u, v]) * (side / part)
    if rng.random() < 0.5:
        image = image[:, ::-1]
        places = np.stack([side - places[:, 2], places[:, 1], side - places[:, 0], places[:, 3]], axis=1)
    if rng.random() < 0.25:
        image = image[..., rng.permutation(3)]
    inside = ((places > 0.0) & (places < side)).all(axis=1)
    return np.ascontiguousarray(image), places[inside]


def _mount(
    image: UInt8, place: Float64, glyphs: Glyphs, rng: np.random.Generator, taken: Bool, is_night: bool
) -> tuple[Float32, bool] | None:
    """Draw a plate where a vehicle of the street bears one; return its box and whether it is ignored."""
    left, top, right, bottom = place + np.array([-0.03, -0.06, 0.03, 0.06]) * np.tile(place[2:] - place[:2], 2)
    wide, high = right - left, bottom - top
    if wide < 6.0 or high < 2.0:
        return None
    design = vary(FAMILIES[int(rng.integers(len(FAMILIES)))], rng)
    plate = draw_plate(design, glyphs, float(np.clip(1.15 * wide, 60, 560)) / design.size_mm[0], rng)
    near = 0.12 * high * rng.uniform(-1.0, 1.0, 4).clip(0.0)
    corners = np.array(
        [[left, top + near[0]], [right, top + near[1]], [right, bottom - near[2]], [left, bottom - near[3]]]
    )
    panel = draw_panel(plate, rng, bare=True, framed=rng.random() < 0.4, glyphs=glyphs)
    gain, lit = _light(rng, is_night)
    paste(image, panel, corners, gain, lit)
    box = np.concatenate([corners.min(axis=0), corners.max(axis=0)])
    _take(taken, box)
    return box.astype(np.float32), bool(wide < _LEAST_PX)


def _light(rng: np.random.Generator, is_night: bool) -> tuple[Float32, float]:
    """Gains (3,) of a panel, and that of its plate in addition."""
    gain = rng.uniform(0.5, 1.15) * rng.normal(1.0, 0.04, 3)
    lit = rng.uniform(0.75, 1.3) if rng.random() < 0.85 else rng.uniform(1.3, 2.2)
    if is_night:
        gain, lit = gain * rng.uniform(0.1, 0.5), rng.uniform(0.8, 5.0)
    return gain.astype(np.float32), float(lit)


def _take(taken: Bool, box: Float64) -> None:
    """Mark the pixels of a plate, so that no other hides them."""
    left, top, right, bottom = box.round().astype(int)
    pad = max(round(0.15 * (bottom - top)), 2)
    taken[max(top - pad, 0) : bottom + pad, max(left - pad, 0) : right + pad] = True


def _paste_clutter(image: UInt8, glyphs: Glyphs, rng: np.random.Generator, gain: float) -> None:
    side = image.shape[0]
    high = float(np.exp(rng.uniform(np.log(10), np.log(260))))
    panel = draw_clutter(glyphs, round(min(high * 1.2, 200)), rng)
    rows, columns = panel.alpha.shape
    width = high * columns / rows
    centre = (float(rng.uniform(0, side)), float(rng.uniform(0, side)))
    turn = rng.normal(0.0, (25.0, 6.0, 4.0))
    stance = Stance(min(width, 1.5 * side), centre, *np.clip(turn, -60, 60).tolist())
    corners = place_corners(stance, columns / rows, _FOCAL_PX, 0.6)
    paste(image, panel, corners, np.full(3, gain * rng.uniform(0.6, 1.1), np.float32), 1.0)


def _paste_plate(
    image: UInt8, glyphs: Glyphs, rng: np.random.Generator, taken: Bool, is_night: bool
) -> tuple[Float32, bool] | None:
    """Paste a plate; return its box and whether it is ignored; None: it found no room."""
    side = image.shape[0]
    design = vary(FAMILIES[int(rng.integers(len(FAMILIES)))], rng)
    width = float(np.exp(rng.uniform(np.log(_WIDTHS_PX[0]), np.log(_WIDTHS_PX[1]))))
    drawn = float(np.clip(1.15 * width, 60, 560))
    plate = draw_plate(design, glyphs, drawn / design.size_mm[0], rng)
    if rng.random() < 0.4:
        plate = soil(plate, rng, rng.uniform(0.2, 0.85))
    panel = draw_panel(plate, rng, bare=rng.random() < 0.22, framed=rng.random() < 0.55, glyphs=glyphs)
    high, wide = panel.alpha.shape
    reach = max(wide, high) / plate.shape[1]
    turn = rng.normal(0.0, (24.0, 7.0, 5.0))
    for _ in range(8):
        margin = 0.15 * width
        centre = (float(rng.uniform(-margin, side + margin)), float(rng.uniform(0, side)))
        if width < 400:
            centre = (float(rng.uniform(0.3 * width, side - 0.3 * width)), centre[1])
        stance = Stance(width, centre, *np.clip(turn, -60, 60).tolist())
        corners = place_corners(stance, plate.shape[1] / plate.shape[0], _FOCAL_PX, reach)
        box, seen = bounds(corners, side, side)
        left, top, right, bottom = box.round().astype(int)
        if seen > 0.15 and not taken[top : bottom + 1, left : right + 1].any():
            break
    else:
        return None
    # The panel must not hide an earlier plate: what is taken keeps its pixels.
    before = image.copy()
    gain, lit = _light(rng, is_night)
    paste(image, panel, corners, gain, lit)
    image[taken] = before[taken]
    _take(taken, box)
    if rng.random() < 0.04:
        _occlude(image, box.astype(np.float32), rng)
    is_small = np.ptp(corners[:, 0]) < _LEAST_PX
    return box.astype(np.float32), bool(is_small or seen < _LEAST_SEEN)


def _occlude(image: UInt8, box: Float32, rng: np.random.Generator) -> None:
    """Hide a part of a plate by a bar, such as a tow bar or a post."""
    left, top, right, bottom = box
    middle = rng.uniform(left, right)
    half = rng.uniform(0.02, 0.1) * (right - left)
    tone = int(rng.integers(0, 120))
    corner = (round(float(middle - half)), round(float(top - (bottom - top))))
    end = (round(float(middle + half)), round(float(bottom + (bottom - top))))
    cv2.rectangle(image, corner, end, (tone, tone, tone), -1)
