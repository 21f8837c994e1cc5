"""Things that look like plates and are none: signs, banners, windows, grilles, posters and marks on the road."""

from __future__ import annotations

import cv2
import numpy as np

from benchmarks.plates.drawing import Panel, draw_grille, latin_fonts, write_row
from benchmarks.plates.fonts import Glyphs
from mirror.arrays import UInt8


def draw_clutter(glyphs: Glyphs, high: int, rng: np.random.Generator) -> Panel:
    """Draw one thing on a panel.

    Args:
        glyphs: masks of characters.
        high: height in pixels.
        rng: draws what it is.
    """
    kinds = (_banner, _poster, _round_sign, _direction_sign, _street_sign, _windows, _grille, _stripes, _blank)
    chances = np.array([0.16, 0.14, 0.1, 0.1, 0.16, 0.1, 0.08, 0.08, 0.08])
    return kinds[int(rng.choice(len(kinds), p=chances))](glyphs, high, rng)


def _whole(image: UInt8, alpha: UInt8 | None = None) -> Panel:
    high, wide = image.shape[:2]
    solid = np.full((high, wide), 255, np.uint8) if alpha is None else alpha
    return Panel(image, solid, (0.0, 0.0, float(wide), float(high)))


def _colours(rng: np.random.Generator) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
    dark, light = rng.integers(0, 110, 3), rng.integers(150, 256, 3)
    pair = (dark, light) if rng.random() < 0.5 else (light, dark)
    first, second = (tuple(int(one) for one in colour) for colour in pair)
    return first, second  # type: ignore[return-value]


def _text(rng: np.random.Generator, least: int, most: int, signs: str = "ABCDEFGHIKLMNOPRSTUVWZ ") -> str:
    return "".join(rng.choice(list(signs), int(rng.integers(least, most))))


def _font(glyphs: Glyphs, rng: np.random.Generator) -> object:
    return glyphs[str(rng.choice(latin_fonts(glyphs)))]


def _banner(glyphs: Glyphs, high: int, rng: np.random.Generator) -> Panel:
    """The long sign of a shop, without the gaps and digits of a plate."""
    wide = round(high * rng.uniform(6.5, 14.0))
    ground, ink = _colours(rng)
    image = np.full((high, wide, 3), ground, np.uint8)
    size = rng.uniform(0.4, 0.8) * high
    text = _text(rng, 8, 18)
    write_row(
        image, text, glyphs, _font(glyphs, rng), (0.03 * wide, 0.97 * wide), 0.5 * (high - size), size, ink, 0.95, rng
    )
    return _whole(image)


def _poster(glyphs: Glyphs, high: int, rng: np.random.Generator) -> Panel:
    """A poster with several rows of text of different sizes."""
    wide = round(high * rng.uniform(0.6, 2.4))
    ground, ink = _colours(rng)
    image = np.full((high, wide, 3), ground, np.uint8)
    if rng.random() < 0.5:
        cv2.circle(
            image, (wide // 2, high // 3), max(high // 5, 1), tuple(int(one) for one in rng.integers(0, 256, 3)), -1
        )
    at, rows = 0.06 * high, int(rng.integers(3, 8))
    for _ in range(rows):
        size = rng.uniform(0.35, 0.75) * 0.9 * high / rows
        text = _text(rng, 4, 22, "ABCDEFGHIKLMNOPRSTUVWZ 0123456789")
        write_row(image, text, glyphs, _font(glyphs, rng), (0.05 * wide, 0.95 * wide), at, size, ink, 0.95, rng)
        at += 0.9 * high / rows
    return _whole(image)


def _round_sign(glyphs: Glyphs, high: int, rng: np.random.Generator) -> Panel:
    """A round, square or triangular traffic sign with a number."""
    image, alpha = np.zeros((high, high, 3), np.uint8), np.zeros((high, high), np.uint8)
    rim, ground = ((190, 30, 35), (240, 240, 240)) if rng.random() < 0.6 else ((240, 240, 240), (25, 70, 160))
    middle, radius = (high // 2, high // 2), max(high // 2 - 1, 1)
    kind = rng.random()
    for colour, share in ((rim, 1.0), (ground, 0.8)):
        if kind < 0.6:
            cv2.circle(image, middle, max(round(share * radius), 1), colour, -1)
        else:
            low = round((1.0 - share) * radius)
            cv2.rectangle(image, (low, low), (high - 1 - low, high - 1 - low), colour, -1)
    cv2.circle(alpha, middle, radius, 255, -1) if kind < 0.6 else alpha.fill(255)
    ink = (20, 20, 20) if ground[0] > 128 else (240, 240, 240)
    text = _text(rng, 1, 4, "0123456789P")
    write_row(image, text, glyphs, _font(glyphs, rng), (0.2 * high, 0.8 * high), 0.3 * high, 0.4 * high, ink, 0.9, rng)
    return _whole(image, alpha)


def _direction_sign(glyphs: Glyphs, high: int, rng: np.random.Generator) -> Panel:
    """A direction sign: two to four names of towns with arrows."""
    wide = round(high * rng.uniform(1.0, 2.2))
    ground = ((20, 70, 160), (30, 110, 70), (235, 235, 230), (235, 190, 40))[int(rng.integers(4))]
    ink = (240, 240, 240) if ground[0] < 100 else (20, 20, 20)
    image = np.full((high, wide, 3), ground, np.uint8)
    line = max(high // 40, 1)
    cv2.rectangle(image, (line, line), (wide - line, high - line), ink, line)
    rows = int(rng.integers(2, 5))
    for row in range(rows):
        top, size = (row + 0.25) * high / rows, 0.45 * high / rows
        text = _text(rng, 4, 11)
        write_row(image, text, glyphs, _font(glyphs, rng), (0.08 * wide, 0.75 * wide), top, size, ink, 0.95, rng)
        ends = (round(0.8 * wide), round(top + 0.5 * size)), (round(0.93 * wide), round(top + 0.5 * size))
        cv2.arrowedLine(image, *ends, ink, line, tipLength=0.4)
    return _whole(image)


def _street_sign(glyphs: Glyphs, high: int, rng: np.random.Generator) -> Panel:
    """The name of a street or a shop in small letters."""
    wide = round(high * rng.uniform(2.2, 6.0))
    ground = ((20, 60, 150), (25, 100, 65), (235, 235, 230), (90, 60, 40), (30, 30, 34))[int(rng.integers(5))]
    ink = (240, 240, 240) if ground[0] < 100 else (20, 20, 20)
    image = np.full((high, wide, 3), ground, np.uint8)
    if rng.random() < 0.6:
        line = max(high // 30, 1)
        cv2.rectangle(image, (line, line), (wide - 1 - line, high - 1 - line), ink, line)
    words = [_text(rng, 1, 2) + _text(rng, 2, 11, "abcdefghiklmnoprstuvw") for _ in range(int(rng.integers(1, 3)))]
    rows = [" ".join(words)] if rng.random() < 0.7 else words
    size = rng.uniform(0.45, 0.7) * high / len(rows)
    for number, text in enumerate(rows):
        top = (number + 0.5) * high / len(rows) - 0.5 * size
        write_row(image, text, glyphs, _font(glyphs, rng), (0.05 * wide, 0.95 * wide), top, size, ink, 0.92, rng)
    return _whole(image)


def draw_foliage(image: UInt8, rng: np.random.Generator) -> None:
    """Draw leaves against the sky or a shade into a part of an image (H, W, 3), which is changed."""
    high, wide = (int(rng.integers(side // 5, side)) for side in image.shape[:2])
    v, u = int(rng.integers(0, image.shape[0] - high + 1)), int(rng.integers(0, image.shape[1] - wide + 1))
    field = np.zeros((high, wide), np.float32)
    for octave in range(3, 8):
        cells = (max(2**octave * high // 640, 2), max(2**octave * wide // 640, 2))
        noise = rng.random(cells, np.float32) - 0.5
        field += cv2.resize(noise, (wide, high), interpolation=cv2.INTER_CUBIC) * rng.uniform(0.5, 1.2)
    shares = np.clip(0.5 + field * rng.uniform(1.0, 6.0), 0.0, 1.0)[..., None]
    dark = rng.uniform(0.0, 70.0) * np.array([rng.uniform(0.5, 1.0), 1.0, rng.uniform(0.3, 1.0)])
    light = rng.uniform(90.0, 255.0) * np.array([rng.uniform(0.5, 1.0), 1.0, rng.uniform(0.3, 1.1)])
    leaves = np.clip(dark * (1.0 - shares) + light * shares, 0, 255)
    edge = cv2.resize(rng.random((5, 5), np.float32), (wide, high), interpolation=cv2.INTER_CUBIC)
    cover = np.clip((edge - 0.35) * 5.0, 0.0, 1.0)[..., None]
    part = image[v : v + high, u : u + wide]
    part[:] = (part * (1.0 - cover) + leaves * cover).astype(np.uint8)


def draw_specks(image: UInt8, rng: np.random.Generator) -> None:
    """Draw small marks as on roads and walls: leaves, cracks, stones and lights; the image (H, W, 3) is changed."""
    side = image.shape[0]
    for _ in range(int(rng.integers(3, 30))):
        place = (int(rng.integers(0, side)), int(rng.integers(0, side)))
        axes = (max(round(float(rng.exponential(7.0))), 1), max(round(float(rng.exponential(2.5))), 1))
        local = image[min(place[1], side - 1), min(place[0], side - 1)].astype(float)
        tone = np.clip(local + rng.normal(0.0, 60.0) + rng.normal(0.0, 12.0, 3), 0, 255)
        colour = tuple(int(one) for one in tone)
        cv2.ellipse(image, place, axes, float(rng.normal(0.0, 30.0)), 0, 360, colour, -1, cv2.LINE_AA)


def _windows(glyphs: Glyphs, high: int, rng: np.random.Generator) -> Panel:
    """Rows of windows in a wall."""
    wide = round(high * rng.uniform(0.8, 4.0))
    wall, pane = _colours(rng)
    image = np.full((high, wide, 3), wall, np.uint8)
    rows, columns = int(rng.integers(1, 4)), int(rng.integers(1, 9))
    for row in range(rows):
        for column in range(columns):
            x0, y0 = (column + 0.15) * wide / columns, (row + 0.15) * high / rows
            x1, y1 = (column + 0.85) * wide / columns, (row + 0.85) * high / rows
            tone = tuple(int(one) for one in np.clip(np.array(pane) + rng.normal(0, 25, 3), 0, 255))
            cv2.rectangle(image, (round(x0), round(y0)), (round(x1), round(y1)), tone, -1)
    return _whole(image)


def _grille(glyphs: Glyphs, high: int, rng: np.random.Generator) -> Panel:
    wide = round(high * rng.uniform(1.5, 7.0))
    image = np.full((high, wide, 3), int(rng.integers(0, 256)), np.uint8)
    draw_grille(image, (0, 0, wide, high), rng)
    return _whole(image)


def _stripes(glyphs: Glyphs, high: int, rng: np.random.Generator) -> Panel:
    """Bars as on barriers, crossings, fences and lamps."""
    wide = round(high * rng.uniform(2.0, 8.0))
    ground, ink = _colours(rng)
    image = np.full((high, wide, 3), ground, np.uint8)
    count, lean = int(rng.integers(3, 14)), rng.uniform(-1.0, 1.0) * high
    for number in range(count):
        x, half = (number + 0.5) * wide / count, 0.25 * wide / count
        shape = [[x - half, 0], [x + half, 0], [x + half + lean, high], [x - half + lean, high]]
        cv2.fillPoly(image, [np.array(shape, np.int32)], ink)
    return _whole(image)


def _blank(glyphs: Glyphs, high: int, rng: np.random.Generator) -> Panel:
    """A bright bar without characters: a lamp, a blank sign, a stripe of a van."""
    wide = round(high * rng.uniform(1.5, 7.0))
    ground, ink = _colours(rng)
    image = np.full((high, wide, 3), ground, np.uint8)
    line = max(high // 20, 1)
    cv2.rectangle(image, (line, line), (wide - line, high - line), ink, line)
    return _whole(image)
