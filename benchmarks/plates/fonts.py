"""Characters of number plates as masks: typefaces of packages with free licences, and one of strokes.

A set of typefaces is a file (``glyphs.npz``), so that a machine without the packages can draw plates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from mirror.arrays import UInt8

LATIN: Final = "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-."
SMALL: Final = "abcdefghijklmnopqrstuvwxyz"
"""Characters of signs that no plate has."""
CHINESE: Final = "京津沪渝冀晋辽吉黑苏浙皖闽赣鲁豫鄂湘粤琼川贵云陕甘青学警港澳"
KANA: Final = "あいうえおかきくけこさすせそたちつてとなにぬねの"
ARABIC: Final = "١٢٣٤٥٦٧٨٩أبدرسطكلمنه"
HIGH_PX: Final = 64
"""Height of a mask; a character fills it from top to bottom, but for signs such as the hyphen."""
_REFERENCE: Final = "H"
_DRAWN_PX: Final = 96

Glyphs = Mapping[str, Mapping[str, UInt8]]
"""Masks (HIGH_PX, W), 255 inside, by typeface and character."""
Draw = Callable[[str], UInt8]
"""Draws a character on black, white on a large board."""


def training_fonts(folder: Path) -> dict[str, Draw]:
    """Return the typefaces that plates of the training have.

    Args:
        folder: unpacked packages font-roboto 0.0.1, font-fjallaone 0.1.7, font-source-sans-pro 0.0.1 (PyPI),
            @fontsource/barlow-condensed 5.3.0 and @fontsource/overpass 5.3.0 (npm); their licences are Apache-2.0 and
            OFL-1.1. DejaVu is a part of matplotlib.
    """
    import matplotlib

    own = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    names = (
        "Roboto-Bold.ttf", "Roboto-Medium.ttf", "FjallaOne-Regular.ttf", "SourceSansPro-Bold.ttf",
        "SourceSansPro-Semibold.ttf", "barlow-condensed-latin-500-normal.woff",
        "barlow-condensed-latin-700-normal.woff", "overpass-latin-700-normal.woff", "overpass-latin-500-normal.woff",
    )  # fmt: skip
    files = [next(iter(sorted(folder.rglob(name)))) for name in names]
    files += [own / name for name in ("DejaVuSans-Bold.ttf", "DejaVuSans.ttf", "DejaVuSansMono-Bold.ttf")]
    return {file.stem: _truetype(file) for file in files}


def held_out_fonts() -> dict[str, Draw]:
    """Return the typefaces of plates that no training has seen; all come with matplotlib, Pillow and OpenCV."""
    import matplotlib

    own = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    names = ("STIXGeneralBol.ttf", "cmss10.ttf")
    fonts = {file.stem: _truetype(file) for file in (own / name for name in names)}
    return fonts | {"aileron": _truetype(None), "rubik": _opencv("sans"), "strokes": _strokes}


def draw_glyphs(fonts: Mapping[str, Draw], *, more: bool = True) -> Glyphs:
    """Return the masks of all characters of some typefaces.

    Args:
        fonts: the typefaces.
        more: small letters too, and Chinese, Japanese (of the typeface in OpenCV) and Arabic characters (of DejaVu).
    """
    glyphs: dict[str, dict[str, UInt8]] = {}
    for name, draw in fonts.items():
        glyphs[name] = _masks(draw, LATIN + SMALL if more else LATIN)
    if more:
        glyphs["chinese"], glyphs["kana"] = (_masks(_opencv("uni"), signs, each=True) for signs in (CHINESE, KANA))
    if "DejaVuSans-Bold" in fonts:
        glyphs["arabic"] = _masks(fonts["DejaVuSans-Bold"], ARABIC, each=True)
    return glyphs


def save_glyphs(path: Path, glyphs: Glyphs) -> None:
    """Write masks to a file."""
    flat = {f"{name}/{ord(sign)}": mask for name, masks in glyphs.items() for sign, mask in masks.items()}
    np.savez_compressed(path, **flat)  # type: ignore[arg-type]


@cache
def load_glyphs(path: Path) -> Glyphs:
    """Read masks from a file."""
    glyphs: dict[str, dict[str, UInt8]] = {}
    with np.load(path) as stored:
        for key in stored.files:
            name, code = key.split("/")
            glyphs.setdefault(name, {})[chr(int(code))] = stored[key]
    return glyphs


@cache
def held_out_glyphs() -> Glyphs:
    """Return masks of typefaces that no training has seen; Chinese and Japanese characters are bolder than there."""
    glyphs = draw_glyphs(held_out_fonts(), more=False)
    bold = _opencv("uni", 850)
    return {**glyphs, "chinese": _masks(bold, CHINESE, each=True), "kana": _masks(bold, KANA, each=True)}


def _masks(draw: Draw, signs: str, *, each: bool = False) -> dict[str, UInt8]:
    """Masks of characters, cut to the height of capitals, or each to its own height."""
    reference = _rows(draw(_REFERENCE))
    masks = {}
    for sign in signs:
        board = draw(sign)
        inside = np.flatnonzero(board.max(axis=0) > 40)
        if not len(inside):
            continue
        first, last = _rows(board) if each else reference
        cut = board[first:last, inside[0] : inside[-1] + 1]
        width = max(round(cut.shape[1] * HIGH_PX / cut.shape[0]), 2)
        masks[sign] = np.asarray(cv2.resize(cut, (width, HIGH_PX), interpolation=cv2.INTER_AREA), np.uint8)
    return masks


def _rows(board: UInt8) -> tuple[int, int]:
    rows = np.flatnonzero(board.max(axis=1) > 40)
    return int(rows[0]), int(rows[-1]) + 1


def _truetype(file: Path | None) -> Draw:
    """A typeface of a file; None: the one in Pillow."""
    from PIL import Image, ImageDraw, ImageFont

    font = ImageFont.load_default(_DRAWN_PX) if file is None else ImageFont.truetype(str(file), _DRAWN_PX)

    def draw(sign: str) -> UInt8:
        board = Image.new("L", (3 * _DRAWN_PX, 3 * _DRAWN_PX))
        ImageDraw.Draw(board).text((_DRAWN_PX, _DRAWN_PX), sign, fill=255, font=font)
        return np.asarray(board, np.uint8)

    return draw


def _strokes(sign: str) -> UInt8:
    """A character of the alphabet of strokes that plates of the synthetic street have."""
    from mirror.synth.textures.images.lettering import letter

    board = np.zeros((3 * _DRAWN_PX, 3 * _DRAWN_PX, 3), np.uint8)
    if sign not in "-.":
        place = (_DRAWN_PX, _DRAWN_PX, 1.6 * _DRAWN_PX, 2.0 * _DRAWN_PX)
        letter(board, sign, place, (255, 255, 255), 0.135 * _DRAWN_PX)
    return np.asarray(board[..., 0], np.uint8)


def _opencv(name: str, weight: int = 600) -> Draw:
    """A typeface that is a part of OpenCV 5, 100 thin to 900 black."""
    font = cv2.FontFace(name)

    def draw(sign: str) -> UInt8:
        board = np.zeros((3 * _DRAWN_PX, 3 * _DRAWN_PX, 3), np.uint8)
        place = (_DRAWN_PX, 2 * _DRAWN_PX)
        cv2.putText(board, sign, place, (255, 255, 255), font, _DRAWN_PX, weight)
        return np.asarray(board[..., 0], np.uint8)

    return draw
