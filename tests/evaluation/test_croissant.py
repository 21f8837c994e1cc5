"""Croissant metadata of published datasets: valid for MLCommons' library, which reads the rows that MIRROR reads."""

from __future__ import annotations

import json
import logging
from fnmatch import fnmatch
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.export.audit import audit
from mirror.export.croissant import Publication, write_croissant
from mirror.export.fetch import fetch
from mirror.schema.bundle import Bundle
from tests.evaluation.submissions import SPLIT

mlcroissant = pytest.importorskip("mlcroissant", reason="mlcroissant is in the extra dev alone")

GIVEN = {
    "--url": "https://example.org/street",
    "--creator": "Street office",
    "--date": "2026-03-01",
    "--citation": "@misc{street, title={Street}}",
}


@pytest.fixture(scope="module")
def bundle(root: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bundle that was published and fetched, as a participant has it."""
    folder = tmp_path_factory.mktemp("croissant")
    words = [word for pair in GIVEN.items() for word in pair]
    published = ["dataset", "publish", str(root), "--split", SPLIT, "--out", str(folder / "published")]
    assert main([*published, "--name", "Street", "--licence", "CC-BY-4.0", *words]) == 0
    assert not fetch(str(folder / "published"), folder / "fetched").failed
    return folder / "fetched"


@pytest.fixture(scope="module")
def croissant(bundle: Path) -> mlcroissant.Dataset:
    return mlcroissant.Dataset(bundle / "croissant.json")


def _read(croissant: mlcroissant.Dataset, records: str) -> list[dict[str, Any]]:
    """All rows of a set of records, with the names of columns and text in place of bytes."""
    return [{name.partition("/")[2]: _text(value) for name, value in row.items()} for row in croissant.records(records)]


def _text(value: Any) -> Any:
    """Return text in place of bytes, also in lists."""
    if isinstance(value, list):
        return [_text(one) for one in value]
    return value.decode() if isinstance(value, bytes) else value


def test_mlcroissant_accepts_the_document_without_a_warning(bundle: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        found = mlcroissant.Dataset(bundle / "croissant.json").metadata
    assert not found.ctx.issues.errors and not found.ctx.issues.warnings
    assert not [record for record in caplog.records if record.name == "absl"]
    assert (found.name, found.license, found.url) == ("Street", ["CC-BY-4.0"], GIVEN["--url"])
    assert (found.cite_as, found.creators[0].name) == (GIVEN["--citation"], GIVEN["--creator"])
    assert found.date_published is not None and found.date_published.date().isoformat() == GIVEN["--date"]
    assert "autonomous driving" in (found.keywords or [])


@pytest.mark.parametrize("table", ["scenes", "traversals", "frames", "images", "calibrations"])
def test_mlcroissant_reads_the_rows_that_mirror_reads(bundle: Path, croissant: mlcroissant.Dataset, table: str) -> None:
    expected = mirror.open(bundle).table(table).to_pylist()
    rows = _read(croissant, table)
    assert len(rows) == len(expected) > 0
    left_out = {"geometry", "bbox", "sha256", "source_sha256"}
    assert rows[0].keys() == expected[0].keys() - left_out
    for row, own in zip(rows, expected):
        for name, value in row.items():
            if own[name] is None:
                assert value is None or value != value, name
            else:
                assert value == own[name], name


def test_files_and_their_hashes_are_those_of_the_bundle_and_none_is_withheld(bundle: Path, dataset: Dataset) -> None:
    document = json.loads((bundle / "croissant.json").read_text())
    files = Bundle.model_validate_json((bundle / "bundle.json").read_bytes())
    objects = [one for one in document["distribution"] if one["@type"] == "cr:FileObject"]
    assert {one["contentUrl"]: (one["sha256"], one["contentSize"]) for one in objects} == {
        name: (entry.sha256, f"{entry.bytes} B")
        for name, entry in files.files.items()
        if name.startswith("index/") and name.endswith(".parquet") and not name.endswith("/row_groups.parquet")
    }
    (images,) = (one for one in document["distribution"] if one["@id"] == "files/image/jpeg")
    listed = {name for name in files.files for pattern in images["includes"] if fnmatch(name, pattern)}
    recorded = {row["uri"] for row in dataset.table("images", ["uri"]).to_pylist()}
    assert files.withheld and listed == recorded - set(files.withheld)
    text = (bundle / "croissant.json").read_text()
    assert not any(name in text for name in files.withheld)
    assert f"{len(files.withheld)} images that benchmarks are scored against" in text


def test_mlcroissant_reads_the_published_pixels(bundle: Path, croissant: mlcroissant.Dataset) -> None:
    own = mirror.open(bundle)
    images = {image.uri: image for frame in own.frames() for image in frame.images.values()}
    for row in islice(croissant.records("pixels-jpeg"), 3):
        image = images[row["pixels-jpeg/path"].decode()]
        pixels = np.asarray(row["pixels-jpeg/content"], np.int16)
        # Decoders of JPEG round differently.
        assert np.abs(pixels - image.decode()).max() <= 3


def test_the_file_is_audited_and_verified(root: Path, bundle: Path, tmp_path: Path) -> None:
    assert not audit(str(bundle), root).leaks
    changed = tmp_path / "changed"
    fetch(str(bundle), changed)
    (changed / "croissant.json").write_text("{}")
    report = fetch(str(changed), tmp_path / "again")
    assert [name for name, _ in report.failed] == ["croissant.json"]


def test_what_only_the_publisher_knows_is_asked_for(
    root: Path, dataset: Dataset, bundle: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["dataset", "publish", str(root), "--split", SPLIT, "--out", str(tmp_path / "b"), "--licence", "CC0-1.0"]
    assert main([*words, "--date", "yesterday"]) == 2
    assert "--date: 'yesterday'" in capsys.readouterr().err
    assert main(words) == 0
    assert "run it again with --url, --creator, --date, --contact" in capsys.readouterr().out
    given = [word for pair in {**GIVEN, "--contact": "data@example.org"}.items() for word in pair]
    assert main([*words, *given]) == 0
    assert "run it again" not in capsys.readouterr().out
    again = json.loads((tmp_path / "b" / "croissant.json").read_text())
    assert again["creator"]["name"] == GIVEN["--creator"]
    assert not fetch(str(tmp_path / "b"), tmp_path / "c").failed
    document = Bundle.model_validate_json((bundle / "bundle.json").read_bytes())
    plain = json.loads(write_croissant(dataset, document, (), name="Street", publication=Publication()))
    assert not {"url", "creator", "datePublished"} & plain.keys()
    assert "10.1145/3767308.3835950" in plain["citeAs"]
    assert Publication().missing() == ["--url", "--creator", "--date"]
    with pytest.raises(UsageError, match="outside the traversals"):
        write_croissant(dataset, document, ["drives/a.jpg"], name="Street", publication=Publication())
