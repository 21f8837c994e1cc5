"""What the tests of generated scenes share."""

from __future__ import annotations

from pathlib import Path

import pytest

from hybridworldsim.generation.command import main
from mirror.dataset.dataset import Dataset
from mirror.errors import ExitCode
from tests.generation.clips import write_clips


@pytest.fixture(scope="session")
def models(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A generator and its autoencoder after one step each: their images are noise, which is enough here."""
    folder = tmp_path_factory.mktemp("models")
    clips = write_clips(folder / "clips", count=1)
    words = ["train", str(clips), "--steps", "1", "--autoencoder-steps", "1", "--batch", "1", "--json"]
    words += ["--drop-layout", "0.5"]
    assert main([*words, "--out", str(folder / "out")]) == ExitCode.DONE
    return folder / "out"


@pytest.fixture(scope="session")
def traversal(tiny_dataset: Dataset) -> str:
    """The traversal with the most boxes."""
    counts = {name: tiny_dataset.where(traversal=name).count("boxes") for name in tiny_dataset.traversals()}
    return max(counts, key=lambda name: counts[name])
