"""Seasonal foliage: leaves come out, turn and fall, each at its own time."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from mirror.arrays import Bool, Float64, Int64, Records
from mirror.errors import UsageError
from mirror.synth.model import Material, Model

Colour = tuple[float, float, float]


class Species(IntEnum):
    """Plant species, stored in the high bits of a leaf's seed; leaves with seeds below 2**24 are evergreen."""

    EVERGREEN = 0
    LIME = 1
    PLANE = 2
    BIRCH = 3
    POPLAR = 4
    CHERRY = 5
    OAK = 6
    SHRUB = 7
    CROP = 8
    REED = 9


@dataclass(frozen=True)
class Year:
    """Times at which the leaves of a species appear and fall, as fractions of a year from 1 January in the north.

    Attributes:
        out: time at which the first leaf appears.
        out_span: time between the first and the last leaf to appear.
        fresh: colour of a young leaf, as a factor of its colour in summer.
        fresh_span: duration for which a leaf is young.
        turn: time at which the first leaf turns.
        turn_span: time between the first and the last leaf to turn.
        turned: two factors of the colours that leaves turn to.
        linger: duration for which a turned leaf stays on the plant.
    """

    out: float
    out_span: float
    fresh: Colour
    fresh_span: float
    turn: float
    turn_span: float
    turned: tuple[Colour, Colour]
    linger: float


_FRESH: Final = (1.5, 1.3, 0.9)
_YEARS: Final[dict[Species, Year]] = {
    Species.LIME: Year(0.27, 0.06, _FRESH, 0.12, 0.73, 0.09, ((3.8, 1.95, 0.85), (2.9, 1.75, 0.85)), 0.05),
    Species.PLANE: Year(0.29, 0.06, _FRESH, 0.12, 0.75, 0.10, ((3.2, 1.5, 0.8), (3.4, 1.1, 0.7)), 0.06),
    Species.BIRCH: Year(0.26, 0.05, _FRESH, 0.12, 0.72, 0.08, ((3.8, 2.05, 0.7), (3.5, 1.9, 0.75)), 0.05),
    Species.POPLAR: Year(0.27, 0.05, _FRESH, 0.12, 0.73, 0.08, ((4.0, 2.3, 0.8), (3.4, 2.2, 0.9)), 0.05),
    Species.CHERRY: Year(0.26, 0.03, (10.5, 3.6, 15.0), 0.07, 0.71, 0.08, ((4.6, 0.9, 0.8), (4.4, 0.5, 0.7)), 0.05),
    Species.OAK: Year(0.31, 0.05, _FRESH, 0.12, 0.78, 0.09, ((2.9, 1.2, 0.8), (2.4, 1.0, 0.9)), 0.08),
    Species.SHRUB: Year(0.24, 0.07, _FRESH, 0.12, 0.77, 0.10, ((2.8, 1.6, 0.9), (2.0, 1.4, 0.9)), 0.06),
    Species.CROP: Year(0.22, 0.10, _FRESH, 0.10, 0.50, 0.04, ((4.4, 2.0, 1.8), (3.9, 1.9, 1.7)), 0.10),
}
"""Evergreens and reeds have no entry: their leaves stay."""
_MAX_MISSING: Final = 0.035
"""Largest share of the leaves that are missing on a visit; every visit misses other leaves."""
_THIN: Final = 0.65
"""A crown with less than this share of its leaves has no dark inside."""
_DENSE: Final = 0.85
"""A crown with more than this share of its leaves hides its twigs."""


def draw_leaf_seeds(rng: np.random.Generator, species: Species, number: int) -> Int64:
    """Draw seeds (number,) for the leaves of one plant."""
    return (int(species) << 24) + rng.integers(1 << 24, size=number)


def apply_season(model: Model, season: float, visit: int) -> Model:
    """Return a model with its leaves at a time of the year.

    Args:
        model: any model. Two-sided LEAVES faces change as sprays of leaves, all other LEAVES faces as insides of
            crowns. BARK faces with a species in their seed are hidden while the species is in full leaf. Other
            materials stay.
        season: fraction of the year in [0, 1); 0 is 1 January in the north and 1 July in the south.
        visit: index of the visit; each visit misses a few other leaves.

    Raises:
        UsageError: the season is outside [0, 1).
    """
    if not 0.0 <= season < 1.0:
        raise UsageError(f"season {season}", expected="a fraction of the year in [0, 1)")
    faces, rounds = model.faces.copy(), model.rounds.copy()
    shown = np.ones(len(faces), np.bool_)
    leafy = faces["material"] == Material.LEAVES
    leaves = np.flatnonzero(leafy & (faces["two_sided"] != 0))
    seeds = faces["seed"][leaves]
    shown[leaves] = _color_leaves(faces, leaves, season, _hash_unit(seeds, 0), _hash_unit(seeds, 1))
    shown[leaves] &= _hash_unit(seeds, 2 + visit) >= _MAX_MISSING
    bodies = np.flatnonzero(leafy & (faces["two_sided"] == 0))
    shown[bodies] = _color_insides(faces, bodies, season) >= _THIN
    twigs = np.flatnonzero((faces["material"] == Material.BARK) & (faces["seed"] >= 1 << 24))
    shown[twigs] = crown_share(faces["seed"][twigs], season) < _DENSE
    stays = np.ones(len(rounds), np.bool_)
    inner = np.flatnonzero(rounds["material"] == Material.LEAVES)
    share = _color_insides(rounds, inner, season)
    # The inside shrinks faster than the leaves fall, and lies in their shade.
    rounds["half"][inner] *= share[:, None]
    rounds["colour"][inner] *= (0.5 + 0.5 * share)[:, None]
    stays[inner] = share >= _THIN
    return _keep_faces(model, faces, shown, rounds[stays])


def _color_insides(pieces: Records, bodies: Int64, season: float) -> Float64:
    """Colour the insides of crowns and hedges in place; return the share of leaves that each still has."""
    middling = np.full(len(bodies), 0.5)
    _color_leaves(pieces, bodies, season, middling, middling)
    return crown_share(pieces["seed"][bodies], season)


def crown_share(seeds: Int64, season: float) -> Float64:
    """Return the expected share (N,) of leaves at a season, for plants with given seeds."""
    share = np.ones(len(seeds))
    for species, year in _YEARS.items():
        out = np.clip((season - year.out) / year.out_span, 0.0, 1.0)
        fallen = np.clip((season - year.turn - year.linger) / year.turn_span, 0.0, 1.0)
        share[seeds >> 24 == species] = out - fallen
    return share


def _color_leaves(pieces: Records, leaves: Int64, season: float, early: Float64, late: Float64) -> Bool:
    """Colour leaves for the season in place; return which of them are present.

    Args:
        pieces: faces or ellipsoids, changed in place.
        leaves: (N,) indices of the leaves among them.
        season: fraction of the year.
        early: (N,) how late in the spring of its species each leaf appears, in [0, 1).
        late: (N,) how late in autumn each leaf turns, in [0, 1).
    """
    seeds = pieces["seed"][leaves]
    is_present = np.ones(len(leaves), np.bool_)
    for species, year in _YEARS.items():
        mine = np.flatnonzero(seeds >> 24 == species)
        if not len(mine):
            continue
        out, turn = year.out + year.out_span * early[mine], year.turn + year.turn_span * late[mine]
        is_present[mine] = (season >= out) & (season < turn + year.linger)
        young = np.clip(1.0 - (season - out) / year.fresh_span, 0.0, 1.0)[:, None]
        old = np.clip((season - turn) / (0.5 * year.linger) + 0.5, 0.0, 1.0)[:, None]
        kind = np.where((early[mine] < 0.5)[:, None], *(np.array(factor) for factor in year.turned))
        change = 1.0 + young * (np.array(year.fresh) - 1.0) + old * (kind - 1.0)
        pieces["colour"][leaves[mine]] = np.minimum(pieces["colour"][leaves[mine]] * change, 0.85)
    return is_present


def _hash_unit(seeds: Int64, turn: int) -> Float64:
    """Pseudo-random numbers (N,) in [0, 1), hashed from the seeds and the turn (xor-shift multiply)."""
    shift = np.uint64(turn * 0xC2B2AE3D27D4EB4F & 0xFFFFFFFFFFFFFFFF)
    mixed = seeds.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15) + shift
    mixed = (mixed ^ (mixed >> np.uint64(29))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(32))) * np.uint64(0x94D049BB133111EB)
    return (mixed >> np.uint64(40)).astype(np.float64) / (1 << 24)


def _keep_faces(model: Model, faces: Records, shown: Bool, rounds: Records) -> Model:
    """The model with only the shown faces and the corners that they use."""
    kept = faces[shown]
    index = np.repeat(kept["first"] - np.cumsum(kept["count"]) + kept["count"], kept["count"])
    corners = model.corners[index + np.arange(len(index))]
    kept["first"] = np.cumsum(kept["count"]) - kept["count"]
    return Model(kept, corners, rounds)
