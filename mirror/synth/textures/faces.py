"""Draws the faces of people, feature by feature: the image on the front half of a head."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Final, Literal

import numpy as np

from mirror.arrays import Float32, Float64
from mirror.errors import UsageError
from mirror.portable import arrays
from mirror.synth.textures.catalogue import FACES

Colour = tuple[float, float, float]
Hair = Literal["short", "parted", "fringe", "long", "bun", "bald"]

HEAD_ASPECT: Final = 0.68
"""Width of a head divided by its height; the square image is compressed by this factor on a head."""
_SKINS: Final[tuple[Colour, ...]] = (
    (0.62, 0.44, 0.35), (0.58, 0.39, 0.29), (0.55, 0.37, 0.27), (0.50, 0.33, 0.23), (0.44, 0.28, 0.19),
    (0.36, 0.22, 0.14), (0.27, 0.16, 0.10), (0.19, 0.11, 0.07),
)  # fmt: skip
_HAIRS: Final[tuple[Colour, ...]] = (
    (0.020, 0.016, 0.014), (0.035, 0.023, 0.016), (0.060, 0.036, 0.022), (0.11, 0.065, 0.035), (0.30, 0.20, 0.095),
    (0.16, 0.055, 0.022), (0.34, 0.33, 0.32),
)  # fmt: skip
_EYES: Final[tuple[Colour, ...]] = (
    (0.05, 0.025, 0.012), (0.07, 0.036, 0.018), (0.05, 0.065, 0.035), (0.07, 0.12, 0.19), (0.09, 0.11, 0.12),
)  # fmt: skip
_WHITE: Final = (0.68, 0.66, 0.64)
_DARK: Final = (0.015, 0.012, 0.011)


@dataclass(frozen=True)
class FaceFeatures:
    """The features of one face.

    Attributes:
        skin: colour of the skin; all colours are linear reflectances.
        hair: colour of the hair.
        style: style of the hair.
        eyes: colour of the irises.
        lips: colour of the lips.
        beard: 0 no beard, below 0.5 stubble, 1 full beard.
        moustache: whether the face has a moustache.
        glasses: whether the person wears glasses.
        age: 0 young to 1 old; sets the depth of wrinkles.
        brow: relative thickness of the eyebrows, about 1.
        wide: relative distance of the eyes and size of mouth and nose, about 1.
        feminine: softer brows and nose, fuller lips.
    """

    skin: Colour
    hair: Colour
    style: Hair
    eyes: Colour
    lips: Colour
    beard: float
    moustache: bool
    glasses: bool
    age: float
    brow: float
    wide: tuple[float, float, float]
    feminine: bool


@cache
def draw_features(number: int) -> FaceFeatures:
    """Return the features of a face.

    Args:
        number: image of the catalogue, one of FACES.

    Raises:
        UsageError: the image is not one of FACES.
    """
    if number not in FACES:
        raise UsageError(f"face {number}", expected=f"{FACES.start} to {FACES.stop - 1}")
    rng = np.random.default_rng([number, 20])
    tone = min(int(rng.exponential(2.2)), len(_SKINS) - 1)
    skin = _SKINS[tone]
    old = float(rng.uniform(0.0, 1.0))
    dark = tone >= 4
    hair = _HAIRS[int(rng.integers(0, 2))] if dark else _HAIRS[int(rng.choice(6, p=[0.2, 0.2, 0.2, 0.2, 0.14, 0.06]))]
    if old > 0.78:
        hair = _HAIRS[6]
    feminine = bool(rng.random() < 0.5)
    styles: tuple[Hair, ...] = ("long", "bun", "fringe", "long") if feminine else ("short", "parted", "short", "bald")
    eyes = _EYES[int(rng.integers(0, 2))] if dark else _EYES[int(rng.integers(len(_EYES)))]
    red = np.array([0.82, 0.50, 0.52]) if feminine else np.array([0.80, 0.60, 0.60])
    hairy = 0.0 if feminine else float(rng.choice([0.0, 0.25, 0.4, 1.0], p=[0.45, 0.2, 0.15, 0.2]))
    r, g, b = np.array(skin) * red
    near, nose, mouth = rng.uniform(0.95, 1.05), rng.uniform(0.9, 1.1), rng.uniform(0.92, 1.1)
    return FaceFeatures(
        skin, hair, styles[int(rng.integers(4))], eyes, (float(r), float(g), float(b)), hairy,
        not feminine and (hairy == 1.0 or bool(rng.random() < 0.1)), bool(rng.random() < 0.22), old,
        float(rng.uniform(0.7, 1.0) if feminine else rng.uniform(0.95, 1.35)), (near, nose, mouth), feminine,
    )  # fmt: skip


def face_image(number: int, size_px: int = 128) -> Float32:
    """Draw the front of a head: (size, size, 3) linear red, green and blue.

    The view is along the head's -x axis and covers its extents in y and z; the head's outline is a circle in the image.

    Args:
        number: image of the catalogue, one of FACES.
        size_px: side of the image, pixels.

    Raises:
        UsageError: the image is not one of FACES, or the size is below 16.
    """
    if size_px < 16:
        raise UsageError(f"a face of {size_px} pixels", expected="at least 16")
    person = draw_features(number)
    canvas = _Canvas(size_px, person.skin)
    rng = np.random.default_rng([number, 21])
    _draw_head(canvas, person, rng)
    for side in (-1.0, 1.0):
        _draw_eye(canvas, person, side)
    _draw_nose(canvas, person)
    _draw_mouth(canvas, person)
    _draw_beard(canvas, person, rng)
    _draw_hair(canvas, person, rng)
    if person.glasses:
        _draw_glasses(canvas, person)
    return np.clip(canvas.rgb, 0.0, 1.0).astype(np.float32)


class _Canvas:
    """An image in head units: y from -1 at the chin to 1 at the crown, x from -HEAD_ASPECT to HEAD_ASPECT."""

    def __init__(self, size_px: int, ground: Colour) -> None:
        self.rgb = np.tile(np.array(ground), (size_px, size_px, 1))
        middle = (np.arange(size_px) + 0.5) / size_px * 2.0 - 1.0
        self.x, self.y = HEAD_ASPECT * middle[None, :], -middle[:, None]
        self.edge = 1.0 / size_px

    def window(self, x0: float, x1: float, y0: float, y1: float) -> tuple[slice, slice]:
        """Return the slices of the pixels in a rectangle."""
        size = len(self.rgb)
        left, right = ((x / HEAD_ASPECT + 1.0) * 0.5 * size for x in (x0, x1))
        top, bottom = ((1.0 - y) * 0.5 * size for y in (y1, y0))
        return slice(max(int(top) - 1, 0), max(int(bottom) + 2, 0)), slice(
            max(int(left) - 1, 0), max(int(right) + 2, 0)
        )

    def lay(self, where: tuple[slice, slice], colour: Colour | Float64, share: Float64) -> None:
        """Blend a colour over pixels, by their coverage."""
        part = self.rgb[where]
        part += share[..., None] * (np.asarray(colour) - part)

    def shade(self, factor: Colour | float, x: float, y: float, a: float, b: float, soft: float = 0.9) -> None:
        """Multiply the pixels of an ellipse by a factor."""
        where, share = self.ellipse(x, y, a, b, 0.0, soft)
        self.rgb[where] *= 1.0 + share[..., None] * (np.asarray(factor) - 1.0)

    def blob(
        self, colour: Colour, x: float, y: float, a: float, b: float, *, turn: float = 0.0, soft: float = 0.0,
        share: float = 1.0,
    ) -> None:  # fmt: skip
        """Draw an ellipse with semi-axes a and b."""
        where, inside = self.ellipse(x, y, a, b, turn, soft)
        self.lay(where, colour, share * inside)

    def ellipse(
        self, x: float, y: float, a: float, b: float, turn: float, soft: float
    ) -> tuple[tuple[slice, slice], Float64]:
        """Return the pixels of an ellipse and their coverage; ``soft`` is the width of its edge by its radius."""
        reach = max(a, b) * (1.0 + soft) + 2.0 * self.edge
        where = self.window(x - reach, x + reach, y - reach, y + reach)
        dx, dy = self.x[:, where[1]] - x, self.y[where[0]] - y
        cos, sin = arrays.cos(turn), arrays.sin(turn)
        radius = arrays.hypot((cos * dx + sin * dy) / a, (cos * dy - sin * dx) / b)
        return where, _step((1.0 - radius) / max(soft, self.edge / min(a, b)))

    def stroke(
        self, colour: Colour, points: list[tuple[float, float]], width: float, *, soft: float = 0.0, share: float = 1.0,
        taper: float = 1.0,
    ) -> None:  # fmt: skip
        """Draw a line through points; ``taper`` is its width at the end divided by that at the start."""
        xs, ys = zip(*points)
        reach = width * (1.0 + soft) + 2.0 * self.edge
        where = self.window(min(xs) - reach, max(xs) + reach, min(ys) - reach, max(ys) + reach)
        px, py = self.x[:, where[1]], self.y[where[0]]
        most = np.zeros((py.shape[0], px.shape[1]))
        pieces = len(points) - 1
        for k, ((x0, y0), (x1, y1)) in enumerate(pairwise(points)):
            dx, dy = x1 - x0, y1 - y0
            along = np.clip(((px - x0) * dx + (py - y0) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
            gap = arrays.hypot(px - x0 - along * dx, py - y0 - along * dy)
            half = width * (1.0 + (taper - 1.0) * (k + along) / pieces)
            most = np.maximum(most, _step((half - gap) / np.maximum(soft * half, self.edge)))
        self.lay(where, colour, share * most)


def _step(depth: Float64) -> Float64:
    """0 to 1 over depths from -1 to 1."""
    share = np.clip(0.5 + 0.5 * depth, 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


def _scale_colour(colour: Colour, factor: float) -> Colour:
    return colour[0] * factor, colour[1] * factor, colour[2] * factor


def _draw_head(canvas: _Canvas, person: FaceFeatures, rng: np.random.Generator) -> None:
    """Shade the forehead, eye sockets, cheeks and jaw."""
    canvas.rgb *= 1.0 + 0.04 * _mottle(rng, len(canvas.rgb), 9)[..., None]
    canvas.shade((1.07, 1.06, 1.05), 0.0, 0.38, 0.34, 0.20)
    blush = (1.06, 0.95, 0.94) if person.feminine else (1.04, 0.97, 0.96)
    for side in (-1.0, 1.0):
        canvas.shade(blush, side * 0.34, -0.26, 0.20, 0.16)
        canvas.shade((1.06, 1.05, 1.05), side * 0.31, -0.16, 0.13, 0.07)
        canvas.shade((0.72, 0.68, 0.68), side * 0.27, 0.07, 0.19, 0.12)
        canvas.shade((0.70, 0.66, 0.64), side * 0.12, 0.08, 0.06, 0.12)
        canvas.shade((0.78, 0.75, 0.73), side * 0.52, -0.62, 0.16, 0.34)
        if person.age > 0.5:
            canvas.stroke(
                _scale_colour(person.skin, 0.55),
                [(side * 0.17, -0.34), (side * 0.26, -0.50), (side * 0.27, -0.62)],
                0.012,
                soft=1.0,
                share=person.age - 0.3,
            )
            canvas.stroke(
                _scale_colour(person.skin, 0.6),
                [(side * 0.15, -0.06), (side * 0.28, -0.10), (side * 0.40, -0.05)],
                0.012,
                soft=1.0,
                share=person.age - 0.3,
            )
    canvas.shade((0.80, 0.76, 0.74), 0.0, -0.72, 0.16, 0.05)
    canvas.shade((0.62, 0.58, 0.56), 0.0, -1.05, 0.40, 0.16)
    if person.age > 0.65:
        for y in (0.40, 0.48):
            canvas.stroke(
                _scale_colour(person.skin, 0.7), [(-0.26, y), (0.0, y + 0.02), (0.26, y)], 0.010, soft=1.0, share=0.5
            )


def _draw_eye(canvas: _Canvas, person: FaceFeatures, side: float) -> None:
    """Draw an eye: eyeball, iris, pupil, highlight, lids, lashes and brow."""
    x, y = side * 0.275 * person.wide[0], 0.03
    half, open_ = 0.125, 0.050 if person.feminine else 0.044
    outer, inner = x + side * half, x - side * half
    where, ball = canvas.ellipse(x, y, half, open_, side * 0.06, 0.05)
    px, py = canvas.x[:, where[1]], canvas.y[where[0]]
    gap = arrays.hypot(px - x, py - y - 0.004)
    white = np.array(_WHITE) * (0.62 + 0.38 * np.clip((y + 0.03 - py) / 0.05, 0.0, 1.0))[..., None]
    canvas.lay(where, np.broadcast_to(white, (*ball.shape, 3)), ball)
    canvas.lay(where, _scale_colour(person.eyes, 0.6), ball * _step((0.056 - gap) / canvas.edge))
    canvas.lay(where, person.eyes, ball * _step((0.044 - gap) / (0.5 * canvas.edge)))
    canvas.lay(where, _DARK, ball * _step((0.024 - gap) / canvas.edge))
    canvas.blob((0.9, 0.9, 0.9), x + 0.02, y + 0.024, 0.010, 0.010, share=0.8)
    lid = [(inner, y - 0.012), (x - side * 0.06, y + open_ * 0.92), (x + side * 0.05, y + open_), (outer, y + 0.012)]
    canvas.stroke(_DARK, lid, 0.017 if person.feminine else 0.012, soft=0.4, share=0.9)
    fold = [(inner, y + 0.035), (x, y + open_ + 0.04), (outer, y + 0.035)]
    canvas.stroke(_scale_colour(person.skin, 0.45), fold, 0.010, soft=0.8, share=0.7)
    below = [(inner, y - 0.012), (x, y - open_), (outer, y + 0.012)]
    canvas.stroke(_scale_colour(person.skin, 0.5), below, 0.008, soft=0.8, share=0.7)
    canvas.blob(_scale_colour(person.skin, 0.8), inner, y - 0.012, 0.015, 0.010)
    brow = [(x - side * 0.135, y + 0.145), (x + side * 0.03, y + 0.195), (x + side * 0.18, y + 0.145)]
    colour = _scale_colour(person.hair, 0.8) if person.age < 0.78 else _scale_colour(person.hair, 0.5)
    canvas.stroke(colour, brow, 0.034 * person.brow, soft=0.5, share=0.85, taper=0.45)


def _draw_nose(canvas: _Canvas, person: FaceFeatures) -> None:
    wide = person.wide[1] * (0.92 if person.feminine else 1.0)
    canvas.shade((1.12, 1.11, 1.10), 0.0, -0.10, 0.045, 0.22, 0.8)
    canvas.shade((1.12, 1.10, 1.09), 0.0, -0.29, 0.07, 0.06, 0.8)
    dark = (0.70, 0.64, 0.61)
    for side in (-1.0, 1.0):
        canvas.shade(dark, side * 0.085 * wide, -0.12, 0.035, 0.20)
        canvas.shade((0.80, 0.74, 0.72), side * 0.13 * wide, -0.31, 0.05, 0.06, 0.8)
        canvas.stroke(_scale_colour(person.skin, 0.42), [(side * 0.155 * wide, -0.27), (side * 0.165 * wide, -0.325),
                      (side * 0.12 * wide, -0.365)], 0.012, soft=1.0, share=0.75)  # fmt: skip
        canvas.blob(
            _scale_colour(person.skin, 0.16), side * 0.062 * wide, -0.362, 0.036, 0.017, turn=side * 0.35, soft=0.4
        )
    canvas.shade((0.68, 0.62, 0.60), 0.0, -0.40, 0.12, 0.035)


def _draw_mouth(canvas: _Canvas, person: FaceFeatures) -> None:
    half, y = 0.205 * person.wide[2], -0.555
    full = 0.050 if person.feminine else 0.034
    canvas.shade((0.86, 0.82, 0.80), 0.0, -0.47, 0.025, 0.05)
    upper, lower = _scale_colour(person.lips, 0.78), person.lips
    canvas.blob(lower, 0.0, y - 0.6 * full, 0.80 * half, 1.05 * full, soft=0.25)
    canvas.blob(upper, -0.30 * half, y + 0.35 * full, 0.66 * half, 0.75 * full, turn=0.10, soft=0.25)
    canvas.blob(upper, 0.30 * half, y + 0.35 * full, 0.66 * half, 0.75 * full, turn=-0.10, soft=0.25)
    canvas.shade((1.2, 1.2, 1.2), 0.0, y - 0.8 * full, 0.4 * half, 0.35 * full)
    line = [(-half, y + 0.012), (-0.3 * half, y), (0.0, y - 0.006), (0.3 * half, y), (half, y + 0.012)]
    canvas.stroke(_scale_colour(person.lips, 0.22), line, 0.013, soft=0.6, share=0.95)
    for side in (-1.0, 1.0):
        canvas.shade((0.66, 0.62, 0.60), side * (half + 0.02), y, 0.035, 0.03)


def _draw_beard(canvas: _Canvas, person: FaceFeatures, rng: np.random.Generator) -> None:
    """Draw stubble or a full beard on jaw and chin, and a moustache."""
    x, y = np.abs(canvas.x), canvas.y
    grain = 1.0 + 0.35 * _mottle(rng, len(canvas.rgb), 40)
    colour = np.array(person.hair)
    everywhere = slice(None), slice(None)
    if person.beard > 0.0:
        line = -0.70 + 0.55 * arrays.power(np.clip((x - 0.22) / 0.36, 0.0, 1.0), 1.5)
        jaw = _step((line - y) / 0.07) * (1.0 - _step((0.20 - arrays.hypot(x / 1.1, (y + 0.555) * 2.3)) / 0.04))
        canvas.lay(everywhere, colour * grain[..., None], np.clip(0.92 * person.beard * jaw, 0.0, 1.0))
    if person.moustache:
        rise = _step((0.050 - np.abs(y + 0.462 + 0.22 * x)) / 0.02) * _step((0.24 - x) / 0.04)
        canvas.lay(everywhere, colour * grain[..., None], 0.85 * rise)


def _draw_hair(canvas: _Canvas, person: FaceFeatures, rng: np.random.Generator) -> None:
    """Draw the hair on the front half of the head: hairline, temples, fringe."""
    x, y = canvas.x, canvas.y
    side = np.abs(x)
    line = {
        "short": 0.60 - 0.9 * arrays.power(np.clip(side - 0.38, 0.0, None), 1.4),
        "parted": 0.64 - 0.16 * np.abs(x - 0.2) - 1.0 * arrays.power(np.clip(side - 0.40, 0.0, None), 1.4),
        "fringe": 0.34 + 0.03 * arrays.cos(9.0 * x) - 1.6 * np.clip(side - 0.36, 0.0, None),
        "long": 0.66 - 0.55 * np.abs(x - 0.08) - 4.0 * np.clip(side - 0.45, 0.0, None),
        "bun": 0.62 - 0.30 * side**2 - 1.2 * np.clip(side - 0.44, 0.0, None),
        "bald": 1.3 - 1.9 * np.clip(side - 0.36, 0.0, None),
    }[person.style]
    ragged = line + 0.025 * _mottle(rng, len(canvas.rgb), 24)[:1]
    share = _step((y - ragged) / 0.035)
    temple = {"long": -1.2, "fringe": -0.5, "bun": 0.12}.get(person.style, -0.10)
    edge = 0.53 if person.style in ("long", "fringe") else 0.585
    share = np.maximum(share, _step((side - edge) / 0.03) * _step((y - temple) / 0.05))
    streak = 1.0 + 0.30 * _mottle(rng, len(canvas.rgb), 30)[:1] + 0.12 * _mottle(rng, len(canvas.rgb), 30)
    gloss = 1.0 + 0.35 * arrays.exp(-(((y - 0.78) / 0.08) ** 2))
    everywhere = slice(None), slice(None)
    shadow = _step((y + 0.07 - ragged) / 0.06)
    canvas.rgb *= 1.0 - 0.28 * (shadow * (1.0 - share))[..., None]
    canvas.lay(everywhere, np.array(person.hair) * (streak * gloss)[..., None], share)


def _draw_glasses(canvas: _Canvas, person: FaceFeatures) -> None:
    frame = (0.02, 0.02, 0.022)
    for side in (-1.0, 1.0):
        x, y = side * 0.275 * person.wide[0], 0.02
        ring = [
            (x + 0.165 * float(arrays.cos(a)), y + 0.115 * float(arrays.sin(a)))
            for a in np.linspace(0.0, 2.0 * np.pi, 17)
        ]
        canvas.stroke(frame, ring, 0.014)
        canvas.stroke(frame, [(x + side * 0.165, y + 0.03), (side * 0.66, y + 0.06)], 0.012)
    canvas.stroke(frame, [(-0.11, 0.04), (0.0, 0.06), (0.11, 0.04)], 0.013)


def _mottle(rng: np.random.Generator, size_px: int, cells: int) -> Float64:
    """Smooth noise (size, size) in [-1, 1] with ``cells`` cells along a side."""
    coarse = rng.uniform(-1.0, 1.0, (cells + 1, cells + 1))
    at = (np.arange(size_px) + 0.5) / size_px * cells
    low = np.minimum(at.astype(np.int64), cells - 1)
    share = at - low
    rows = coarse[low] * (1.0 - share)[:, None] + coarse[low + 1] * share[:, None]
    return rows[:, low] * (1.0 - share) + rows[:, low + 1] * share
