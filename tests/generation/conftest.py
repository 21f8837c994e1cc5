"""What the tests of generated scenes share."""

from __future__ import annotations

from pathlib import Path

import pytest

from mirror.dataset.dataset import Dataset


@pytest.fixture(scope="session")
def models(generator_models: Path) -> Path:
    """A generator and its autoencoder after one step each: their images are noise, which is enough here."""
    return generator_models / "out"


@pytest.fixture(scope="session")
def traversal(tiny_dataset: Dataset) -> str:
    """The traversal with the most boxes."""
    counts = {name: tiny_dataset.where(traversal=name).count("boxes") for name in tiny_dataset.traversals()}
    return max(counts, key=lambda name: counts[name])
