"""The declaration of the experiment, and its hash."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from benchmarks.studies.annotation.scoring import Bar

FILE: Final = Path(__file__).with_name("experiment.toml")


@dataclass(frozen=True)
class Declaration:
    """What is fixed before the first run; `experiment.toml` explains each value."""

    preset: str
    seed: int
    training: tuple[str, ...]
    held_out: tuple[str, ...]
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
    streets, training, score = document["streets"], document["training"], document["score"]
    return Declaration(
        preset=streets["preset"],
        seed=streets["seed"],
        training=tuple(streets["training"]),
        held_out=tuple(streets["held_out"]),
        seeds=tuple(training["seeds"]),
        core_minutes=tuple(training["core_minutes"]),
        threads=training["threads"],
        settings=training["settings"],
        bar=Bar(score["range_m"], score["visible_px"], tuple(score["thresholds_m"])),
        bars=document["bars"],
        hash=hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest(),
    )
