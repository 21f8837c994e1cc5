"""The whole dataset, made once, and copies of it to be broken."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from tests.integrity.clean import Broken, make_clean


@pytest.fixture(scope="session")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_clean(tmp_path_factory.mktemp("clean") / "dataset")


@pytest.fixture
def broken(clean: Path, tmp_path: Path) -> Broken:
    # Edits replace files and never write into them, so that links will do.
    return Broken(Path(shutil.copytree(clean, tmp_path / "dataset", copy_function=os.link)))
