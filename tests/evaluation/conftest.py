"""A small synthetic dataset with a split, shared by the tests of evaluation."""

from __future__ import annotations

from pathlib import Path

import pytest

import mirror
import mirror.synth
from mirror.dataset.dataset import Dataset
from mirror.dataset.splits import make_split
from mirror.ingest.request import IngestOptions
from mirror.ingest.rois import read_rois
from mirror.ingest.run import ingest_recordings
from mirror.schema.documents import NovelTraversal

SPLIT = "novel"


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    folder = tmp_path_factory.mktemp("evaluation")
    recordings = mirror.synth.write_recordings(folder / "tiny", "tiny", 0).recordings
    report = ingest_recordings(
        recordings, read_rois(folder / "tiny" / "rois.geojson"), folder / "dataset", IngestOptions()
    )
    assert not report.failures
    make_split(folder / "dataset", SPLIT, NovelTraversal(train=1, held_out=1))
    return mirror.open(folder / "dataset")


@pytest.fixture(scope="session")
def root(dataset: Dataset) -> Path:
    return Path(dataset.root)
