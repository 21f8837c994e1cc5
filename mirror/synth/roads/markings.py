"""Markings of carriageways. A layout is a row of marks; a mark is a patch of stripes in a street's own coordinates.

u runs along the street, v to the left of its middle, in metres. A pixel's share of a mark is the exact mean over the
pixel's footprint, so lines fade with distance and do not flicker (`mirror.synth.render.carriageway`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from mirror.arrays import Records
from mirror.errors import UsageError
from mirror.synth.model import Material, Model
from mirror.synth.model.surfaces import join_parts

MOST_MARKS: Final = 32
FAR_M: Final = 1e6

WHITE: Final = (0.62, 0.62, 0.60)
YELLOW: Final = (0.60, 0.42, 0.06)
RED: Final = (0.24, 0.075, 0.055)

MARK: Final = np.dtype(
    [
        ("u_low", np.float64),
        ("u_high", np.float64),
        ("v_low", np.float64),
        ("v_high", np.float64),
        ("u_period", np.float64),
        ("u_duty", np.float64),
        ("u_phase", np.float64),
        ("v_period", np.float64),
        ("v_duty", np.float64),
        ("v_phase", np.float64),
        ("slant", np.float64),
        ("red", np.float64),
        ("green", np.float64),
        ("blue", np.float64),
        ("strength", np.float64),
        ("worn", np.float64),
        ("soft", np.float64),
    ]
)
"""A patch [u_low, u_high] x [v_low, v_high] of stripes.

Along u the stripes start at ``u_phase + slant v``, repeat every ``u_period`` metres (0: no stripes) and fill the share
``u_duty``; likewise along v. ``strength`` is the opacity: 0 ends the row, values below 1 let the carriageway show
through (wheel tracks). ``worn`` is the share of paint that is worn off in places; ``soft`` is the width in metres over
which the edges along the street fade."""


@dataclass(frozen=True)
class Mark:
    """One mark, with the fields of MARK."""

    u_m: tuple[float, float]
    v_m: tuple[float, float]
    u_stripes: tuple[float, float, float] = (0.0, 1.0, 0.0)
    v_stripes: tuple[float, float, float] = (0.0, 1.0, 0.0)
    slant: float = 0.0
    colour: tuple[float, float, float] = WHITE
    strength: float = 1.0
    worn: float = 0.25
    soft_m: float = 0.0


_ALONG: Final = (-FAR_M, FAR_M)


def solid_line(v_m: float, half_m: float) -> Mark:
    """Return a continuous line at offset v."""
    return Mark(_ALONG, (v_m - half_m, v_m + half_m))


def dashed_line(v_m: float, half_m: float, period_m: float, length_m: float) -> Mark:
    """Return a dashed line at offset v."""
    return replace(solid_line(v_m, half_m), u_stripes=(period_m, length_m / period_m, 0.0))


def parking_bays(inner_m: float, outer_m: float) -> tuple[Mark, ...]:
    """Return the parking bays beside the lane: a dashed line, and ticks between the bays."""
    low, high = min(inner_m, outer_m), max(inner_m, outer_m)
    return (
        replace(dashed_line(inner_m, 0.05, 6.0, 1.6), worn=0.5),
        Mark(_ALONG, (low, high), u_stripes=(6.0, 0.10 / 6.0, -0.75), worn=0.5),
    )


def cycle_lane(low_m: float, high_m: float) -> tuple[Mark, ...]:
    """Return a red cycle lane between two white lines."""
    return (
        Mark(_ALONG, (low_m, high_m), colour=RED, strength=0.85, worn=0.3),
        dashed_line(low_m if low_m > 0 else high_m, 0.06, 2.0, 1.0),
    )


def wheel_tracks(v_m: float) -> tuple[Mark, ...]:
    """Return the polished wheel tracks of a lane with its middle at v."""
    return tuple(
        Mark(
            _ALONG, (v_m + side - 0.28, v_m + side + 0.28), colour=(0.15, 0.15, 0.15), strength=0.20, worn=0.6,
            soft_m=0.35,
        )
        for side in (-0.82, 0.82)
    )  # fmt: skip


def oil_stain(v_m: float) -> Mark:
    """Return the oil stain along the middle of a lane."""
    return Mark(_ALONG, (v_m - 0.3, v_m + 0.3), colour=(0.05, 0.05, 0.05), strength=0.24, worn=0.7, soft_m=0.4)


def zebra_marks(u_m: tuple[float, float], half_m: float) -> Mark:
    """Return a zebra crossing between two stations, over a carriageway of width ``2 * half_m``."""
    return Mark(u_m, (-half_m + 0.25, half_m - 0.25), v_stripes=(1.0, 0.5, 0.25))


def stop_line(u_m: tuple[float, float], v_m: tuple[float, float]) -> Mark:
    """Return a stop line across a lane."""
    return Mark(u_m, v_m)


def yield_line(u_m: tuple[float, float], v_m: tuple[float, float]) -> Mark:
    """Return a broken yield line across a lane."""
    return Mark(u_m, v_m, v_stripes=(0.75, 0.5 / 0.75, v_m[0] + 0.12))


def hatched_area(u_m: tuple[float, float], v_m: tuple[float, float], slant: float) -> Mark:
    """Return a hatched area that is closed to traffic."""
    return Mark(u_m, v_m, u_stripes=(2.0, 0.4, 0.0), slant=slant)


def pack_layouts(rows: Sequence[Sequence[Mark]]) -> Records:
    """Pack layouts into a table (L, MOST_MARKS) MARK.

    Raises:
        UsageError: a row has more than MOST_MARKS marks.
    """
    table = np.zeros((len(rows), MOST_MARKS), MARK)
    for number, marks in enumerate(rows):
        if len(marks) > MOST_MARKS:
            raise UsageError(f"layout {number} has {len(marks)} marks", expected=f"{MOST_MARKS} at most")
        for place, mark in enumerate(marks):
            table[number, place] = (
                *mark.u_m, *mark.v_m, *mark.u_stripes, *mark.v_stripes, mark.slant, *mark.colour, mark.strength,
                mark.worn, mark.soft_m,
            )  # fmt: skip
    return table


def restrict_layouts(model: Model, table: Records) -> tuple[Model, Records]:
    """Give each piece of carriageway a layout with only the marks that reach it, so that a pixel tests fewer marks.

    Args:
        model: model with ASPHALT faces; their layouts index the table.
        table: (L, K) MARK.

    Returns:
        The model with new layout indices, and the new table.
    """
    faces, corners = join_parts([model.faces]), model.corners
    paved = np.flatnonzero(faces["material"] == Material.ASPHALT)
    if not len(paved):
        return model, table
    first, count = faces["first"][paved], faces["count"][paved]
    of_corner = np.repeat(np.arange(len(paved)), count)
    at = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + first[of_corner]
    starts = np.cumsum(count) - count
    low, high = np.empty((len(paved), 2)), np.empty((len(paved), 2))
    for axis, (name, shift) in enumerate((("u_axis", "u0"), ("v_axis", "v0"))):
        values = np.einsum("ni,ni->n", corners[at], faces[name][paved][of_corner]) + faces[shift][paved][of_corner]
        low[:, axis], high[:, axis] = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    rows = table[faces["layout"][paved]]
    reaches = rows["strength"] > 0.0
    for axis, (begin, end) in enumerate((("u_low", "u_high"), ("v_low", "v_high"))):
        reaches &= (rows[begin] < high[:, axis, None]) & (rows[end] > low[:, axis, None])
    kinds, layout = np.unique(
        np.concatenate([faces["layout"][paved, None], reaches], axis=1), axis=0, return_inverse=True
    )
    short = np.zeros((len(kinds), max(int(kinds[:, 1:].sum(axis=1).max()), 1)), MARK)
    for row, kind in enumerate(kinds):
        marks = table[kind[0]][kind[1:].astype(np.bool_)]
        short[row, : len(marks)] = marks
    faces["layout"][paved] = layout.ravel()
    return Model(faces, corners, model.rounds), short
