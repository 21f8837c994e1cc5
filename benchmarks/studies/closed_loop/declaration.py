"""The declaration of the experiment, and its hash."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from mirror.schema.hashing import hash_document

FILE: Final = Path(__file__).with_name("experiment.toml")


@dataclass(frozen=True)
class Declaration:
    """The choices that are fixed before the first run; `experiment.toml` explains each value.

    Attributes:
        streets: the two streets that are driven in.
        camera: the camera of the policies.
        worlds: the exact worlds, by the seed of their images' noise.
        reconstruction: how the other worlds are made.
        images: training images of the policies' perception.
        training: of the perception.
        policies: what differs in the training of each policy.
        controller: what all policies share.
        scenarios: the scenarios and their seeds.
        triggers: how triggers are tuned.
        references: policies that read no image.
        report: of the statistics.
        bars: the figures to reach.
        budget: processor time.
        hash: SHA-256 of all values.
    """

    streets: Mapping[str, Any]
    camera: Mapping[str, Any]
    worlds: Mapping[str, int]
    reconstruction: Mapping[str, Any]
    images: Mapping[str, Any]
    training: Mapping[str, Any]
    policies: Mapping[str, Mapping[str, Any]]
    controller: Mapping[str, float]
    scenarios: Mapping[str, Any]
    triggers: Mapping[str, Any]
    references: Mapping[str, Any]
    report: Mapping[str, Any]
    bars: Mapping[str, float]
    budget: Mapping[str, Any]
    hash: str


def load_declaration(file: Path = FILE) -> Declaration:
    """Load a declaration; its hash is of its values, not of their formatting."""
    return make_declaration(tomllib.loads(file.read_text()))


def make_declaration(document: Mapping[str, Any]) -> Declaration:
    """Make the declaration of a document, with its hash."""
    return Declaration(**document, hash=hash_document(document))
