"""Names of the shared synthetic dataset in the tests of evaluation."""

from __future__ import annotations

from pathlib import Path

import pytest

from mirror.dataset.dataset import Dataset


@pytest.fixture(scope="session")
def dataset(tiny_dataset: Dataset) -> Dataset:
    return tiny_dataset


@pytest.fixture(scope="session")
def root(tiny_dataset: Dataset) -> Path:
    return Path(tiny_dataset.root)
