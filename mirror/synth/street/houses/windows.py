"""Window patterns of walls: the rows that a FACADE face's layout refers to."""

from __future__ import annotations

from enum import IntEnum
from typing import Final, NamedTuple

import numpy as np

from mirror.arrays import Records
from mirror.synth.textures.catalogue import Grain


class Windows(IntEnum):
    """Kinds of windows of a wall, stored as the ``layout`` of a FACADE face."""

    BLIND = 0
    """No windows: plaster."""
    BLIND_BRICK = 1
    TALL = 2
    """Tall casements with a surround, as in stucco of the 19th century."""
    TALL_BRICK = 3
    SASH = 4
    """Sash windows with many small panes."""
    SASH_BRICK = 5
    MODERN = 6
    """Broad dark panes."""
    MODERN_BRICK = 7
    PANEL = 8
    """Concrete slabs with joints."""
    RIBBON = 9
    """Long rows of panes, as in offices and schools."""
    CURTAIN_WALL = 10
    """Glass across the whole wall."""
    COTTAGE = 11
    """Small windows with shutters."""
    COTTAGE_BRICK = 12
    SIDE = 13
    """Few small windows, for sides and backs."""
    SIDE_BRICK = 14
    LOFT = 15
    """Large iron windows with small panes, as in workshops."""
    CLADDING = 16
    """Metal sheets without windows."""
    BOARDS = 17
    """Wooden boards without windows, as in barns."""
    FAR = 18
    """Windows of a distant house."""
    DORMER = 19
    """One small window that fills the wall."""


class Pattern(NamedTuple):
    """One row of the pattern table; lengths in metres, shares from 0 to 1.

    Attributes:
        grain: surface of the wall, a :class:`Grain`.
        storey_m: approximate height of a storey; a face holds a whole number of storeys.
        pitch_m: approximate distance between windows; a face holds a whole number of them.
        width_m: width of a window; 0: no windows.
        height_m: height of a window.
        sill_m: distance from the floor to the window's lower edge.
        panes: number of panes side by side.
        transom: distance from the window's top to a horizontal bar, as a share of its height; 0: no bar.
        frame_m: width of the frame.
        frame: reflectance of the frame.
        surround_m: width of the surround in the wall.
        trim: colour of surrounds and string courses, from 0 (the wall's colour) to 1 (a light colour).
        course_m: height of the string course at the foot of each storey.
        joint_m: width of the joints between storeys and columns.
        shutter_m: width of a shutter on either side.
        curtains: share of windows with curtains or blinds.
        glass: reflectance behind bare panes by day.
        gloss: mirror reflectance of the panes.
        lit: share of windows that are lit at night, relative to the share of the lighting setting.
        cool: share of the lit windows with cold white light.
    """

    grain: Grain
    storey_m: float = 3.1
    pitch_m: float = 2.7
    width_m: float = 0.0
    height_m: float = 1.6
    sill_m: float = 0.9
    panes: int = 2
    transom: float = 0.0
    frame_m: float = 0.06
    frame: float = 0.6
    surround_m: float = 0.0
    trim: float = 0.5
    course_m: float = 0.0
    joint_m: float = 0.0
    shutter_m: float = 0.0
    curtains: float = 0.6
    glass: float = 0.03
    gloss: float = 0.12
    lit: float = 1.0
    cool: float = 0.12


_TALL: Final = Pattern(
    Grain.PLASTER, 3.3, 2.5, 1.15, 1.95, 0.75, transom=0.3, surround_m=0.16, trim=0.55, course_m=0.18
)
_SASH: Final = Pattern(
    Grain.PLASTER, 3.1, 2.6, 1.1, 1.6, 0.85, panes=3, transom=0.5, frame_m=0.045, frame=0.7, surround_m=0.1, trim=0.4
)
_MODERN: Final = Pattern(
    Grain.PLASTER, 3.1, 3.4, 2.1, 1.75, 0.75, panes=2, frame=0.05, frame_m=0.07, gloss=0.16, curtains=0.45
)
_COTTAGE: Final = Pattern(
    Grain.PLASTER, 2.8, 3.1, 1.1, 1.25, 0.9, transom=0.35, surround_m=0.1, trim=0.5, shutter_m=0.5
)
_SIDE: Final = Pattern(Grain.PLASTER, 3.1, 4.2, 0.9, 1.35, 0.95, panes=1, frame=0.55)

PATTERNS: Final[dict[Windows, Pattern]] = {
    Windows.BLIND: Pattern(Grain.PLASTER),
    Windows.BLIND_BRICK: Pattern(Grain.BRICK),
    Windows.TALL: _TALL,
    Windows.TALL_BRICK: _TALL._replace(grain=Grain.BRICK, course_m=0.22, trim=0.65),
    Windows.SASH: _SASH,
    Windows.SASH_BRICK: _SASH._replace(grain=Grain.BRICK, trim=0.6),
    Windows.MODERN: _MODERN,
    Windows.MODERN_BRICK: _MODERN._replace(grain=Grain.BRICK),
    Windows.PANEL: Pattern(
        Grain.CONCRETE, 2.8, 3.2, 1.7, 1.45, 0.85, panes=3, frame_m=0.07, frame=0.65, joint_m=0.035, curtains=0.75
    ),
    Windows.RIBBON: Pattern(
        Grain.CONCRETE, 3.5, 2.4, 2.3, 1.7, 0.95, panes=2, transom=0.25, frame_m=0.06, frame=0.3,
        curtains=0.4, glass=0.04, gloss=0.2, lit=0.8, cool=0.75,
    ),
    Windows.CURTAIN_WALL: Pattern(
        Grain.METAL, 3.6, 1.5, 1.44, 2.75, 0.8, panes=1, frame_m=0.03, frame=0.12,
        curtains=0.25, glass=0.045, gloss=0.34, lit=0.7, cool=0.8,
    ),
    Windows.COTTAGE: _COTTAGE,
    Windows.COTTAGE_BRICK: _COTTAGE._replace(grain=Grain.BRICK, shutter_m=0.0, trim=0.6),
    Windows.SIDE: _SIDE,
    Windows.SIDE_BRICK: _SIDE._replace(grain=Grain.BRICK),
    Windows.LOFT: Pattern(
        Grain.BRICK, 4.2, 4.0, 2.8, 2.6, 0.9, panes=5, transom=0.4, frame_m=0.035, frame=0.06,
        surround_m=0.12, trim=0.3, curtains=0.1, lit=0.5, cool=0.6,
    ),
    Windows.CLADDING: Pattern(Grain.METAL, 30.0, 1.2, joint_m=0.025),
    Windows.BOARDS: Pattern(Grain.WOOD, 30.0, 1.2, joint_m=0.02),
    Windows.FAR: Pattern(Grain.PLASTER, 3.2, 3.0, 1.5, 1.7, 0.8, panes=1, frame=0.4, curtains=0.5, gloss=0.08, lit=0.8),
    Windows.DORMER: Pattern(Grain.PLASTER, 1.6, 1.4, 0.95, 1.05, 0.25, frame_m=0.055, frame=0.7),
}  # fmt: skip
"""The row of each :class:`Windows`."""


def pattern_table() -> Records:
    """Return the patterns as a record array (rows,) with :class:`Pattern`'s fields, for compiled kernels."""
    kind = np.dtype([(name, np.int64 if name in ("grain", "panes") else np.float64) for name in Pattern._fields])
    return np.array([tuple(PATTERNS[row]) for row in Windows], kind)


def window_grid(windows: Windows, width_m: float, height_m: float) -> tuple[int, int]:
    """Return the numbers of columns and storeys of windows on a face, as the renderer computes them."""
    pattern = PATTERNS[windows]
    return max(int(width_m / pattern.pitch_m + 0.5), 1), max(int(height_m / pattern.storey_m + 0.5), 1)
