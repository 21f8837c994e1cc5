"""Draws plates and the parts of vehicles around them, in the plane of the plate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np

from benchmarks.plates.designs import Colour, Design, write_rows
from benchmarks.plates.fonts import HIGH_PX, Glyphs
from mirror.arrays import UInt8

_SPECIAL: Final = {"chinese", "kana", "arabic"}


def latin_fonts(glyphs: Glyphs) -> list[str]:
    """Return the names of the typefaces with Latin characters."""
    return sorted(set(glyphs) - _SPECIAL)


def draw_plate(
    design: Design, glyphs: Glyphs, scale: float, rng: np.random.Generator, *, strict: bool = False
) -> UInt8:
    """Draw a plate (H, W, 3), RGB.

    Args:
        design: its design.
        glyphs: masks of the characters.
        scale: pixels for one millimetre.
        rng: draws the characters and the typeface.
        strict: rows follow the patterns exactly.
    """
    width, height = (max(round(side * scale), 4) for side in design.size_mm)
    image = _ground(design, width, height, rng)
    left, right, top, bottom = _draw_band(image, design, glyphs, rng)
    font = glyphs[str(rng.choice(latin_fonts(glyphs)))]
    texts = write_rows(design, rng, strict=strict)
    inner = bottom - top
    heights = [share * inner for share in design.shares[: len(texts)]]
    if design.caption:
        size = 0.13 * inner
        text = "".join(rng.choice(list("ABCDEFGHILMNORSTUV"), design.caption))
        above = rng.random() < 0.6
        at = top + 0.05 * inner if above else bottom - 0.05 * inner - size
        write_row(image, text, glyphs, font, (left, right), at, size, design.ink, 0.7, rng)
        top, bottom = (top + 0.16 * inner, bottom) if above else (top, bottom - 0.16 * inner)
    gap = max((bottom - top - sum(heights)) / (len(heights) + 1), 0.0)
    at = top + gap
    for text, high in zip(texts, heights):
        write_row(image, text, glyphs, font, (left, right), at, high, design.ink, design.fill, rng)
        at += high + gap
    if design.border:
        line = max(round(0.022 * height), 1)
        cv2.rectangle(image, (line, line), (width - 1 - line, height - 1 - line), design.ink, line)
    return image


def _ground(design: Design, width: int, height: int, rng: np.random.Generator) -> UInt8:
    image = np.full((height, width, 3), design.ground, np.uint8)
    if design.fade is None:
        return image
    ramp = np.linspace(0.0, 1.0, height)[:, None, None] ** rng.uniform(0.5, 2.0)
    mixed = (1.0 - ramp) * np.array(design.ground) + ramp * np.array(design.fade)
    image[:] = mixed.astype(np.uint8)
    if rng.random() < 0.5:
        u = np.linspace(0.0, width, 7)
        v = height * rng.uniform(0.55, 0.95, 7)
        hills = np.concatenate([np.stack([u, v], 1), [[width, height], [0, height]]]).astype(np.int32)
        cv2.fillPoly(image, [hills], tuple(int(0.85 * one) for one in design.fade))
    return image


def _draw_band(
    image: UInt8, design: Design, glyphs: Glyphs, rng: np.random.Generator
) -> tuple[float, float, float, float]:
    """Draw the band, and return left, right, top and bottom of what remains for the rows."""
    height, width = image.shape[:2]
    margin = 0.02 * width
    left, right, top, bottom = margin, width - margin, 0.0, float(height)
    size = round(design.band_share * height)
    light = (240, 240, 240)
    for side in ("left", "right"):
        if design.band in (side, "both"):
            first = 0 if side == "left" else width - size
            image[:, first : first + size] = design.band_colour
            if side == "left" and min(size, height) > 6:
                middle = (first + size // 2, round(0.3 * height))
                cv2.circle(image, middle, max(round(0.3 * size), 1), (235, 200, 50), max(round(0.06 * size), 1))
            font = glyphs[latin_fonts(glyphs)[0]]
            sign = font[str(rng.choice(list("FDNIAEB")))]
            _stamp(image, sign, first + 0.3 * size, 0.62 * height, 0.4 * size, 0.26 * height, light)
            left, right = (size + margin, right) if side == "left" else (left, width - size - margin)
    if design.band in ("top", "bottom"):
        first = 0 if design.band == "top" else height - size
        image[first : first + size] = design.band_colour
        font = glyphs[latin_fonts(glyphs)[0]]
        text = "".join(rng.choice(list("ABEILNORSTU"), 6))
        write_row(
            image, text, glyphs, font, (0.2 * width, 0.8 * width), first + 0.2 * size, 0.6 * size, light, 0.7, rng
        )
        top, bottom = (float(size), bottom) if design.band == "top" else (top, float(height - size))
    return left, right, top, bottom


def write_row(
    image: UInt8, text: str, glyphs: Glyphs, font: dict[str, UInt8] | object, span: tuple[float, float], top: float,
    high: float, ink: Colour, fill: float, rng: np.random.Generator,
) -> None:  # fmt: skip
    """Write a row into a span, as wide as it fits."""
    own: dict[str, UInt8] = font  # type: ignore[assignment]
    stretch = rng.uniform(0.8, 1.15)
    masks: list[UInt8 | str | None] = []
    widths = []
    for sign in text:
        mask = own.get(sign)
        for more in ("chinese", "kana", "arabic"):
            mask = glyphs[more].get(sign) if mask is None and more in glyphs else mask
        masks.append("seal" if sign == "o" else mask)
        full = 0.4 * HIGH_PX if sign in " " or mask is None else float(mask.shape[1])
        widths.append((0.5 * HIGH_PX if sign == "o" else full * stretch) * high / HIGH_PX)
    gap = 0.16 * high
    total = sum(widths) + gap * max(len(text) - 1, 0)
    room = fill * (span[1] - span[0])
    squeeze = min(room / max(total, 1e-6), 1.25)
    at = 0.5 * (span[0] + span[1] - squeeze * total)
    for shape, wide in zip(masks, widths):
        if isinstance(shape, str):
            radius = 0.22 * high
            place = (round(at + 0.5 * squeeze * wide), round(top + 0.5 * high))
            cv2.circle(image, place, max(round(radius), 1), tuple(int(one) for one in rng.integers(30, 220, 3)), -1)
        elif shape is not None:
            _stamp(image, shape, at, top, squeeze * wide, high, ink)
        at += squeeze * (wide + gap)


def _stamp(image: UInt8, mask: UInt8, left: float, top: float, wide: float, high: float, ink: Colour) -> None:
    """Blend a character into an image."""
    x, y, w, h = round(left), round(top), max(round(wide), 1), max(round(high), 1)
    x0, y0, x1, y1 = max(x, 0), max(y, 0), min(x + w, image.shape[1]), min(y + h, image.shape[0])
    if x1 <= x0 or y1 <= y0:
        return
    small = cv2.resize(mask, (w, h), interpolation=cv2.INTER_AREA)[y0 - y : y1 - y, x0 - x : x1 - x]
    alpha = small[..., None].astype(np.float32) / 255.0
    part = image[y0:y1, x0:x1]
    part[:] = (part * (1.0 - alpha) + np.array(ink, np.float32) * alpha).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Panel:
    """The part of a vehicle that bears a plate.

    Attributes:
        image: (H, W, 3) RGB.
        alpha: (H, W) 255 where it hides what is behind.
        box_px: left, top, right and bottom of the plate in it.
    """

    image: UInt8
    alpha: UInt8
    box_px: tuple[float, float, float, float]


def draw_panel(plate: UInt8, rng: np.random.Generator, *, bare: bool, framed: bool, glyphs: Glyphs) -> Panel:
    """Place a plate on the panel of a vehicle, or on nothing.

    Args:
        plate: (H, W, 3).
        rng: draws the panel.
        bare: nothing but the plate and its frame.
        framed: whether a holder surrounds the plate.
        glyphs: characters of the holder and of badges.
    """
    high, wide = plate.shape[:2]
    if bare:
        pad_x, pad_up, pad_down = (max(round(0.12 * high), 2),) * 3
    else:
        pad_x, pad_up, pad_down = (round(rng.uniform(*span)) for span in ((0.3 * wide, 1.1 * wide),) + (
            (0.5 * high, 3.0 * high),) * 2)  # fmt: skip
    size = (high + pad_up + pad_down, wide + 2 * pad_x)
    paint = rng.integers(0, 256, 3) if rng.random() < 0.4 else np.full(3, rng.integers(8, 245))
    image = np.full((*size, 3), paint, np.uint8)
    alpha = np.zeros(size, np.uint8)
    left, top = pad_x, pad_up
    if not bare:
        alpha[:] = 255
        _draw_body(image, alpha, (left, top, wide, high), paint, rng, glyphs)
    if framed:
        lip = max(round(rng.uniform(0.04, 0.1) * high), 1)
        low = max(round(rng.uniform(0.04, 0.22) * high), 1)
        tone = int(rng.integers(5, 60)) if rng.random() < 0.8 else int(rng.integers(120, 220))
        y0, y1, x0, x1 = max(top - lip, 0), top + high + low, max(left - lip, 0), left + wide + lip
        image[y0:y1, x0:x1], alpha[y0:y1, x0:x1] = tone, 255
        if low > 0.12 * high:
            font = glyphs[str(rng.choice(latin_fonts(glyphs)))]
            text = "".join(rng.choice(list("ABCDEGILMNORSTU."), int(rng.integers(6, 16))))
            ink = (225, 225, 225) if tone < 100 else (20, 20, 20)
            span = (left + 0.1 * wide, left + 0.9 * wide)
            write_row(image, text, glyphs, font, span, top + high + 0.15 * low, 0.65 * low, ink, 0.8, rng)
    image[top : top + high, left : left + wide] = plate
    alpha[top : top + high, left : left + wide] = 255
    return Panel(image, alpha, (float(left), float(top), float(left + wide), float(top + high)))


def _draw_body(
    image: UInt8, alpha: UInt8, place: tuple[int, int, int, int], paint: object, rng: np.random.Generator,
    glyphs: Glyphs,
) -> None:  # fmt: skip
    """Draw sheet metal, a bumper, a recess, grilles, lights and badges around the place of a plate."""
    left, top, wide, high = place
    rows, columns = image.shape[:2]
    shade = np.linspace(rng.uniform(0.7, 1.3), rng.uniform(0.5, 1.1), rows)[:, None, None]
    image[:] = np.clip(image * shade, 0, 255).astype(np.uint8)
    if rng.random() < 0.6:
        edge = round(rng.uniform(0, rows))
        tone = int(rng.integers(10, 80)) if rng.random() < 0.7 else int(rng.integers(80, 220))
        image[edge:] = tone
    for _ in range(int(rng.integers(0, 4))):
        at = int(rng.integers(0, rows))
        cv2.line(image, (0, at), (columns, at + int(rng.integers(-4, 5))), (15, 15, 15), max(round(0.02 * high), 1))
    if rng.random() < 0.45:
        y0 = int(rng.integers(0, max(rows - high // 2, 1)))
        y1, x0 = y0 + int(rng.uniform(0.4, 2.0) * high), int(rng.uniform(-0.1, 0.4) * columns)
        draw_grille(image, (x0, y0, columns - x0, y1), rng)
    if rng.random() < 0.5:
        grow = rng.uniform(0.05, 0.5) * high
        recess = np.clip(np.array(paint) * rng.uniform(0.2, 1.2), 0, 255)
        box = (round(left - grow), round(top - grow)), (round(left + wide + grow), round(top + high + grow))
        cv2.rectangle(image, *box, tuple(int(one) for one in recess), -1)
    for side in (0, 1):
        if rng.random() < 0.4:
            x = round(rng.uniform(0.0, 0.15) * columns)
            x = x if side == 0 else columns - x
            y, w, h = (
                round(rng.uniform(0, rows)),
                round(rng.uniform(0.2, 0.8) * high),
                round(rng.uniform(0.3, 1.5) * high),
            )
            colour = (int(rng.integers(120, 255)), int(rng.integers(0, 200)), int(rng.integers(0, 160)))
            cv2.ellipse(image, (x, y), (max(w, 1), max(h, 1)), 0, 0, 360, colour, -1)
    if rng.random() < 0.4:
        font = glyphs[str(rng.choice(latin_fonts(glyphs)))]
        text = "".join(rng.choice(list("ABCDEGILMNORSTUX0123456789"), int(rng.integers(2, 9))))
        size, x = rng.uniform(0.15, 0.5) * high, rng.uniform(0.0, 0.7) * columns
        ink = (210, 210, 215) if rng.random() < 0.7 else (30, 30, 32)
        write_row(image, text, glyphs, font, (x, x + wide * 0.6), rng.uniform(0, rows - size), size, ink, 0.9, rng)
    if rng.random() < 0.5:
        feather = max(round(0.1 * min(rows, columns)), 1) | 1
        alpha[:2], alpha[-2:], alpha[:, :2], alpha[:, -2:] = 0, 0, 0, 0
        alpha[:] = cv2.blur(alpha, (feather, feather))


def draw_grille(image: UInt8, box: tuple[int, int, int, int], rng: np.random.Generator) -> None:
    """Draw dark slats in a box."""
    x0, y0, x1, y1 = box
    tone, light = int(rng.integers(5, 50)), int(rng.integers(40, 200))
    cv2.rectangle(image, (x0, y0), (x1, y1), (tone, tone, tone), -1)
    step = max(round(rng.uniform(0.08, 0.3) * (y1 - y0)), 3)
    for at in range(0, (x1 - x0) if (upright := rng.random() < 0.3) else (y1 - y0), step):
        ends = ((x0 + at, y0), (x0 + at, y1)) if upright else ((x0, y0 + at), (x1, y0 + at))
        cv2.line(image, *ends, (light,) * 3, max(step // 4, 1))
