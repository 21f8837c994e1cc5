"""A dataset of one drive of the synthetic street, for verbs that run a network on every image."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from mirror.ingest.request import IngestOptions
from mirror.ingest.rois import read_rois
from mirror.ingest.run import ingest_recordings
from mirror.synth import SynthReport


@pytest.fixture(scope="session")
def ingested_drive(tiny_recordings: SynthReport, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("drive") / "dataset"
    first = tiny_recordings.recordings[0]
    rois = read_rois(first.parent / "rois.geojson")
    assert not ingest_recordings([first], rois, root, IngestOptions(workers=1)).failures
    return root


@pytest.fixture
def one_drive(ingested_drive: Path, tmp_path: Path) -> Path:
    """The dataset of the first drive, which a test may change."""
    return Path(shutil.copytree(ingested_drive, tmp_path / "dataset"))
