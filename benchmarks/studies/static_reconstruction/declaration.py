"""The declaration of the study, and its hash."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Final

from mirror.schema.hashing import hash_document

FILE: Final = Path(__file__).with_name("comparison.toml")
TRAINING: Final = "training"
NOVEL: Final = "novel"
"""Groups of views of the declared protocol."""


@dataclass(frozen=True)
class Tuning:
    """The street and the grid of the tuning, the same for every method."""

    preset: str
    seed: int
    scene: str
    core_minutes: float
    rates: tuple[float, ...]
    sizes: tuple[float, ...]


@dataclass(frozen=True)
class Declaration:
    """Everything that is equal for all methods; `comparison.toml` explains each value."""

    preset: str
    scenes_seed: int
    split: str
    split_seed: int
    scenes: tuple[str, ...]
    protocol: str
    width_px: int
    width_long_px: int
    initialise: str
    seeds: tuple[int, ...]
    core_minutes: float
    core_minutes_curve: tuple[float, ...]
    core_minutes_long: float
    policy: str
    tuning: Tuning
    hash: str


@cache
def load_declaration() -> Declaration:
    """Load the committed declaration; its hash is of its values, not of their formatting."""
    document = tomllib.loads(FILE.read_text())
    scenes, images, training = document["scenes"], document["pictures"], document["training"]
    grid = document["tuning"]
    return Declaration(
        preset=scenes["preset"],
        scenes_seed=scenes["seed"],
        split=scenes["split"],
        split_seed=scenes["split_seed"],
        scenes=tuple(scenes["names"]),
        protocol=images["protocol"],
        width_px=images["width_px"],
        width_long_px=images["width_long_px"],
        initialise=document["beginning"]["initialise"],
        seeds=tuple(training["seeds"]),
        core_minutes=training["core_minutes"],
        core_minutes_curve=tuple(training["core_minutes_curve"]),
        core_minutes_long=training["core_minutes_long"],
        policy=document["appearance"]["policy"],
        tuning=Tuning(
            preset=grid["preset"],
            seed=grid["seed"],
            scene=grid["scene"],
            core_minutes=grid["core_minutes"],
            rates=tuple(grid["rates"]),
            sizes=tuple(grid["sizes"]),
        ),
        hash=hash_document(document),
    )
