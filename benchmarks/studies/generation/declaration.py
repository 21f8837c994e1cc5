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
        clips: how the clips are made.
        training: of the generators.
        distillation: of the student.
        scoring: how rollouts are scored.
        bars: the figures to reach.
        budget: processor time.
        cut: parts of the study that are not run, with the reason.
        hash: SHA-256 of all values.
    """

    clips: Mapping[str, Any]
    training: Mapping[str, Any]
    distillation: Mapping[str, Any]
    scoring: Mapping[str, Any]
    bars: Mapping[str, float]
    budget: Mapping[str, float]
    cut: Mapping[str, str]
    hash: str


def load_declaration(file: Path = FILE) -> Declaration:
    """Load a declaration; its hash is of its values, not of their formatting."""
    document = tomllib.loads(file.read_text())
    return Declaration(**document, hash=hash_document(document))
