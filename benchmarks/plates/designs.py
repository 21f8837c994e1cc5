"""Designs of number plates: sizes, colours, rows of characters, bands and captions, by family of countries.

Plates of the training are drawn from wide ranges around `FAMILIES`; those of the test are `HELD_OUT`, as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal

import numpy as np

Colour = tuple[int, int, int]
Band = Literal["none", "left", "right", "both", "top", "bottom"]

WHITE: Final = (232, 232, 228)
YELLOW: Final = (238, 192, 42)
BLACK: Final = (24, 24, 28)
BLUE: Final = (20, 60, 150)
GREEN: Final = (40, 140, 80)
RED: Final = (170, 34, 36)
NAVY: Final = (26, 36, 92)


@dataclass(frozen=True)
class Design:
    """Look of a plate, but for its characters.

    Attributes:
        name: family of countries.
        size_mm: width and height.
        rows: patterns of the rows: ``L`` a letter, ``D`` a digit, ``C`` a Chinese sign, ``K`` a kana, ``A`` an Arabic
            sign, ``o`` a round seal; others as they stand.
        ground: colour of the plate.
        ink: colour of the characters.
        shares: height of each row, as a share of the plate's height.
        band: where a coloured band lies.
        band_colour: its colour.
        band_share: width of the band at the side, or height of one above, as a share of the plate's height.
        caption: length of a caption above or below the rows; 0: none.
        fade: a second colour that the ground turns to, with hills; None: a plain ground.
        border: whether a line runs along the edge.
        fill: share of the width that a row takes.
    """

    name: str
    size_mm: tuple[float, float]
    rows: tuple[str, ...]
    ground: Colour = WHITE
    ink: Colour = BLACK
    shares: tuple[float, ...] = (0.68,)
    band: Band = "none"
    band_colour: Colour = BLUE
    band_share: float = 0.42
    caption: int = 0
    fade: Colour | None = None
    border: bool = True
    fill: float = 0.92


def _design(name: str, size: tuple[float, float], rows: str, **more: object) -> Design:
    split = tuple(rows.split("/"))
    if len(split) == 2 and "shares" not in more:
        more["shares"] = (0.38, 0.42)
    return Design(name, size, split, **more)  # type: ignore[arg-type]


FAMILIES: Final = (
    _design("european", (520, 110), "LLoLL DDDD", band="left"),
    _design("european", (520, 110), "LL DDD LL", band="left"),
    _design("european", (520, 113), "DDDD LLL", band="left", ink=NAVY),
    _design("european, two rows", (340, 200), "LLo/LL DDD", band="left", band_share=0.22),
    _design("european, two rows", (280, 200), "LLL/DDDD", band="left", band_share=0.24),
    _design("british, rear", (520, 111), "LLDD LLL", ground=YELLOW, border=False),
    _design("british, front", (520, 111), "LLDD LLL", band="left", border=False),
    _design("chinese", (440, 140), "CLoDDDDD", ground=BLUE, ink=WHITE),
    _design("chinese, electric", (480, 140), "CLoDDDDDD", ground=(190, 225, 190), fade=(70, 180, 100)),
    _design("chinese, two rows", (440, 220), "CoL/DDDDD", ground=YELLOW, shares=(0.30, 0.52)),
    _design("japanese", (330, 165), "CC DDD/K DD-DD", shares=(0.24, 0.56), ink=(30, 80, 50)),
    _design("japanese, small", (330, 165), "CC DDD/K DD-DD", shares=(0.24, 0.56), ground=YELLOW),
    _design("american", (305, 152), "LLL DDDD", ink=NAVY, caption=8, shares=(0.46,)),
    _design("american", (305, 152), "DLLLDDD", fade=(140, 180, 220), caption=10, shares=(0.46,), ink=RED),
    _design("american, dark", (305, 152), "LLLDDDD", ground=NAVY, ink=YELLOW, caption=9, shares=(0.44,)),
    _design("american", (305, 152), "LL-DDDDD", fade=(230, 170, 110), caption=7, shares=(0.42,), ink=GREEN),
    _design("mercosur", (400, 130), "LLLDLDD", band="top", band_share=0.23, shares=(0.56,)),
    _design("russian", (520, 112), "LDDDLL DD", fill=0.96),
    _design("russian, two rows", (290, 170), "LDDD/LL DD"),
    _design("indian", (500, 120), "LL DD LL DDDD", fill=0.95),
    _design("indian, two rows", (340, 200), "LL DD L/DDDD", ground=YELLOW),
    _design("arabic", (520, 110), "AAAA DDDD", band="right", band_colour=GREEN),
    _design("arabic, two rows", (320, 160), "AAAA AAA/DDDD LLL", shares=(0.36, 0.36)),
    _design("motorcycle", (180, 200), "LLL/DDDD", band="left", band_share=0.2),
    _design("motorcycle", (240, 130), "LLD/DDDD"),
    _design("dark", (440, 120), "LLL DDDD", ground=BLACK, ink=WHITE),
    _design("red", (440, 120), "LL DDDD", ground=RED, ink=WHITE),
    _design("green", (400, 130), "LLL DDD", ground=GREEN, ink=WHITE),
)
"""Families that plates of the training vary."""

HELD_OUT: Final = (
    _design("french", (520, 110), "LL-DDD-LL", band="both", border=False),
    _design("dutch", (520, 110), "DD-LLL-D", ground=(245, 178, 30), band="left"),
    _design("italian", (360, 110), "LL DDDLL", band="both", band_share=0.32),
    _design("swiss", (300, 80), "LLoDDDDDD", fill=0.95),
    _design("swiss, rear", (300, 160), "LLo/DDDDDD"),
    _design("austrian", (520, 120), "LLoDDDLL", band="left", border=True),
    _design("turkish", (520, 110), "DD LL DDD", band="left", band_colour=(0, 70, 170), band_share=0.36),
    _design("israeli", (520, 120), "DDD-DD-DDD", ground=(250, 205, 20), band="left"),
    _design("korean", (520, 110), "DDD DDDD", fill=0.88),
    _design("korean, two rows", (335, 170), "LL DD/DDDD", ground=(30, 110, 70), ink=WHITE, shares=(0.3, 0.5)),
    _design("argentine", (400, 130), "LL DDD LL", band="top", band_colour=(10, 50, 140), band_share=0.2, shares=(0.6,)),
    _design("argentine, older", (294, 129), "LLL DDD", ground=BLACK, ink=WHITE, caption=9, shares=(0.6,)),
    _design("australian", (372, 134), "LLL DDL", caption=12, shares=(0.58,), ink=(20, 30, 110)),
    _design("taiwanese", (380, 160), "LLL-DDDD", caption=6, shares=(0.6,)),
    _design("canadian", (300, 150), "LLLL DDD", ink=(20, 40, 140), caption=11, shares=(0.5,)),
    _design("mexican", (300, 150), "LLL-DD-DD", fade=(190, 215, 200), caption=6, shares=(0.42,)),
    _design("south african", (440, 120), "LL DD LL LL", ink=(40, 90, 60), caption=0),
    _design("thai", (340, 150), "DLL DDDD/LLLLLL", shares=(0.52, 0.24)),
    _design("singaporean", (520, 110), "LLL DDDD L", ground=BLACK, ink=WHITE, border=False),
    _design("norwegian, electric", (520, 110), "LL DDDDD", band="left", fill=0.9),
)
"""Families of the test; the training has none of them, nor their typefaces."""


def vary(design: Design, rng: np.random.Generator) -> Design:
    """Return a design of the training: sizes, colours and rows within wide ranges around a family."""
    width, height = design.size_mm
    varied = replace(
        design,
        size_mm=(width * rng.uniform(0.85, 1.15), height * rng.uniform(0.88, 1.14)),
        ground=_near(design.ground, rng, 22), ink=_near(design.ink, rng, 25),
        band_share=design.band_share * rng.uniform(0.75, 1.25),
        shares=tuple(share * rng.uniform(0.85, 1.12) for share in design.shares),
        band_colour=_near(design.band_colour, rng, 25), fill=design.fill * rng.uniform(0.88, 1.03),
        border=design.border if rng.random() < 0.7 else not design.border,
    )  # fmt: skip
    if rng.random() < 0.12:
        varied = replace(varied, ground=_any(rng, 120, 250), ink=_any(rng, 0, 90))
    if rng.random() < 0.06:
        varied = replace(varied, ground=_any(rng, 0, 110), ink=_any(rng, 170, 255))
    if rng.random() < 0.15:
        varied = replace(varied, band=rng.choice(["none", "left", "both", "top", "bottom", "right"]))
        varied = (
            replace(varied, band_share=min(varied.band_share, 0.22)) if varied.band in ("top", "bottom") else varied
        )
    if rng.random() < 0.1:
        varied = replace(varied, caption=int(rng.integers(4, 14)), shares=tuple(0.72 * one for one in varied.shares))
    return varied


def write_rows(design: Design, rng: np.random.Generator, *, strict: bool = False) -> tuple[str, ...]:
    """Return the texts of the rows of a design; unless strict, signs of some rows are left out or added."""
    texts = []
    for row in design.rows:
        text = "".join(_sign(one, rng) for one in row)
        if not strict and rng.random() < 0.15:
            text += _sign(str(rng.choice(["L", "D"])), rng)
        elif not strict and rng.random() < 0.1 and len(text) > 4:
            text = text[:-1]
        texts.append(text)
    return tuple(texts)


def _sign(pattern: str, rng: np.random.Generator) -> str:
    from benchmarks.plates.fonts import ARABIC, CHINESE, KANA

    signs: Mapping[str, str] = {
        "L": "ABCDEFGHJKLMNPRSTUVWXYZ", "D": "0123456789", "C": CHINESE, "K": KANA, "A": ARABIC,
    }  # fmt: skip
    return str(rng.choice(list(signs[pattern]))) if pattern in signs else pattern


def _near(colour: Colour, rng: np.random.Generator, spread: float) -> Colour:
    moved = np.clip(np.array(colour) + rng.normal(0.0, spread) + rng.normal(0.0, 0.4 * spread, 3), 0, 255).astype(int)
    return int(moved[0]), int(moved[1]), int(moved[2])


def _any(rng: np.random.Generator, low: int, high: int) -> Colour:
    values = rng.integers(low, high, 3)
    return int(values[0]), int(values[1]), int(values[2])
