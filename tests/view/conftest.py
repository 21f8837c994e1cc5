"""The street that the tests of views share."""

from __future__ import annotations

import pytest

from mirror.dataset.dataset import Dataset
from tests.builders.street import make_street


@pytest.fixture(scope="session")
def street(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """A small street with two cameras. Tests do not change it."""
    return make_street(tmp_path_factory.mktemp("street") / "dataset", ("front_wide", "rear"))
