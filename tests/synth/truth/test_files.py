"""Tests that truth is read back as written and that broken files are reported."""

from pathlib import Path

import numpy as np
import pytest

from mirror.errors import DatasetError, RecordingError, SchemaError
from mirror.schema.documents import Roi
from mirror.synth.model import Label
from mirror.synth.truth import Truth
from mirror.synth.truth.files import TruthObject, write_document
from mirror.synth.truth.images import KINDS, read_truth_image, truth_file

RNG = np.random.default_rng(3)


def normals() -> np.ndarray:
    one = RNG.normal(size=(20, 30, 3))
    one /= np.linalg.norm(one, axis=2, keepdims=True)
    one[:3] = np.nan
    one[5, 5] = 0.0, 0.0, -1.0
    one[5, 6] = -1.0, 0.0, 0.0
    return one.astype(np.float32)


def distances() -> np.ndarray:
    one = RNG.uniform(0.1, 300.0, (20, 30)).astype(np.float32)
    one[:3] = np.inf
    one[4, 4], one[4, 5] = np.finfo(np.float32).tiny, 6.5e4
    return one


IMAGES = {
    "depth": (distances(), 0.0),
    "normals": (normals(), 0.51 / 32767),
    "semantic": (RNG.integers(0, 21, (20, 30)).astype(np.uint8), 0.0),
    "instance": (RNG.integers(0, 70, (20, 30)).astype(np.int32) ** 2, 0.0),
    "flow": (np.where(RNG.random((20, 30, 1)) < 0.1, np.nan, RNG.normal(0, 900, (20, 30, 2))).astype(np.float32), 0.0),
}


@pytest.mark.parametrize("kind", KINDS)
def test_truth_images_of_every_kind_are_read_back(tmp_path: Path, kind: str) -> None:
    given, least = IMAGES[kind]
    file = truth_file(tmp_path, kind, "rear", 12)
    file.parent.mkdir(parents=True)
    file.write_bytes(KINDS[kind].encode(given))
    read = read_truth_image(tmp_path, kind, "rear", 12)
    assert read.shape == given.shape
    assert np.array_equal(np.isnan(read), np.isnan(given))
    known = np.isfinite(given)
    off = read[known].astype(float) - given[known]
    assert np.abs(off).max() <= least
    assert np.array_equal(np.isinf(given), np.isinf(read))
    assert KINDS[kind].encode(given) == file.read_bytes()


@pytest.mark.parametrize("kind", KINDS)
def test_missing_and_broken_truth_images_are_reported(tmp_path: Path, kind: str) -> None:
    with pytest.raises(RecordingError, match="missing") as caught:
        read_truth_image(tmp_path, kind, "rear", 12)
    assert caught.value.file == str(truth_file(tmp_path, kind, "rear", 12))
    file = truth_file(tmp_path, kind, "rear", 12)
    file.parent.mkdir(parents=True)
    for data in (b"", b"rubbish", KINDS[kind].encode(IMAGES[kind][0])[:60]):
        file.write_bytes(data)
        with pytest.raises(RecordingError, match="broken"):
            read_truth_image(tmp_path, kind, "rear", 12)


def test_masks_of_another_type_are_refused(tmp_path: Path) -> None:
    file = truth_file(tmp_path, "semantic", "rear", 1)
    file.parent.mkdir(parents=True)
    file.write_bytes(KINDS["instance"].encode(IMAGES["instance"][0]))
    with pytest.raises(RecordingError, match="broken"):
        read_truth_image(tmp_path, "semantic", "rear", 1)


def test_truth_document_lists_labels_and_objects(tmp_path: Path) -> None:
    roi = Roi(scene_id="town", longitude_deg=8.0, latitude_deg=49.0, height_m=110.0)
    written = write_document(tmp_path, roi, ("depth", "instance"), (TruthObject(track_id="t-1", category="car"),))
    truth = Truth(tmp_path)
    assert truth.document == written
    assert truth.document.labels["vegetation"] == Label.VEGETATION
    assert truth.document.scene == roi


def test_missing_truth_and_foreign_documents_are_reported(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="missing"):
        _ = Truth(tmp_path).document
    with pytest.raises(DatasetError, match="missing"):
        Truth(tmp_path).boxes()
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / "truth.json").write_text('{"format": "other"}')
    with pytest.raises(SchemaError):
        _ = Truth(tmp_path).document
