"""The declaration of the experiment, and its hash."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from benchmarks.studies.annotation.scoring import Bar
from mirror.schema.hashing import hash_document

FILE: Final = Path(__file__).with_name("experiment.toml")


@dataclass(frozen=True)
class Streets:
    """The recordings, and which of their drives are not trained on.

    Attributes:
        preset: of `mirror synth`.
        seeds: of `mirror synth`; every seed is a dataset.
        traversals: number of drives through each scene.
        held_out: scenes of the first seed that are not trained on.
    """

    preset: str
    seeds: tuple[int, ...]
    traversals: int
    held_out: tuple[str, ...]


@dataclass(frozen=True)
class Declaration:
    """The choices that are fixed before the first run; `experiment.toml` explains each value.

    Attributes:
        streets: the recordings.
        seeds: of the training; one run each with every budget.
        core_minutes: the budgets.
        threads: number of threads.
        settings: of the training.
        bar: what counts in the score.
        bars: the figures to reach, by core-minutes.
        hash: SHA-256 of all values.
    """

    streets: Streets
    seeds: tuple[int, ...]
    core_minutes: tuple[float, ...]
    threads: int
    settings: Mapping[str, str]
    bar: Bar
    bars: Mapping[str, Mapping[str, float]]
    hash: str


def load_declaration() -> Declaration:
    """Load the committed declaration; its hash is of its values, not of their formatting."""
    document = tomllib.loads(FILE.read_text())
    streets, training, score = (document[name] for name in ("streets", "training", "score"))
    return Declaration(
        streets=Streets(streets["preset"], tuple(streets["seeds"]), streets["traversals"], tuple(streets["held_out"])),
        seeds=tuple(training["seeds"]),
        core_minutes=tuple(training["core_minutes"]),
        threads=training["threads"],
        settings=training["settings"],
        bar=Bar(score["range_m"], score["visible_px"], tuple(score["thresholds_m"])),
        bars=document["bars"],
        hash=hash_document(document),
    )
