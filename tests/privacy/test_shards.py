"""De-identification of images in shards: the bytes of a dataset of files, and what readers and releases get."""

from __future__ import annotations

import hashlib
import io
import tarfile
from pathlib import Path

import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.index import build_index
from mirror.dataset.layout import Layout, seal
from mirror.executors.choice import ExecutorChoice
from mirror.integrity import Cost, check
from mirror.privacy.log import read_log
from mirror.privacy.release.review import ReviewSession
from mirror.privacy.run import deidentify
from mirror.schema.files import read_table, write_bytes
from mirror.schema.tables import IMAGES
from tests.builders.dataset import encode_rows
from tests.builders.shards import put_into_shards
from tests.interruption import interrupt_before
from tests.privacy.conftest import make_dataset, options

SEARCH = ("--detector", "faces", "--detector", "plates", "--plate-region", "XX", "--workers", "1", "--no-cameras")

HERE = ExecutorChoice("serial")


@pytest.fixture(scope="module")
def sharded(tmp_path_factory: pytest.TempPathFactory, marks: None) -> Path:
    """A de-identified dataset whose images lie in shards of a frame or two."""
    root = tmp_path_factory.mktemp("sharded") / "dataset"
    make_dataset(root)
    put_into_shards(Layout(root), limit_bytes=20_000)
    assert deidentify(root, options(executor=HERE)).exit_code() == 0
    return root


def rows_of(root: Path) -> list[dict[str, object]]:
    return [
        {name: value for name, value in row.items() if name not in ("uri", "byte_offset")}
        for row in mirror.open(root).table("images").to_pylist()
    ]


def test_images_in_shards_are_redacted_to_the_bytes_of_files_and_lie_in_shards(
    sharded: Path, deidentified: Path
) -> None:
    assert len(list(sharded.glob("traversals/*/recorded/*.tar"))) > 2
    assert rows_of(sharded) == rows_of(deidentified)
    for one, other in zip(mirror.open(sharded).frames(), mirror.open(deidentified).frames(), strict=True):
        assert {name: image.read(verify=True) for name, image in one.images.items()} == {
            name: image.read() for name, image in other.images.items()
        }
    layer = Layout(sharded).layer(mirror.open(sharded).traversals()[0], "redaction", "deidentify", "1")
    assert sorted(path.name for path in layer.iterdir()) == [
        "images-00000.tar", "images.parquet", "log.jsonl", "manifest.json",
    ]  # fmt: skip
    # Other programs read the archive: the images of a frame follow each other.
    redacted = read_table(layer / "images.parquet", IMAGES).to_pylist()
    with tarfile.open(fileobj=io.BytesIO((layer / "images-00000.tar").read_bytes())) as archive:
        names = archive.getnames()
        read = {name: archive.extractfile(name) for name in names}
        held = {name: file.read() for name, file in read.items() if file is not None}
    in_order = sorted(redacted, key=lambda row: (row["frame_index"], row["camera"]))
    assert names == [f"{row['camera']}/{row['timestamp_ns']}.jpg" for row in in_order]
    data = (layer / "images-00000.tar").read_bytes()
    for row, name in zip(in_order, names):
        assert data[row["byte_offset"] :][: row["byte_length"]] == held[name]
    assert read_log(layer / "log.jsonl") == read_log(
        Layout(deidentified).layer(layer.parts[-4], "redaction", "deidentify", "1") / "log.jsonl"
    )
    found = [{rule.rule_id for rule, _ in check(root, cost=Cost.IMAGES).findings} for root in (sharded, deidentified)]
    assert found[0] == found[1]


def test_the_form_can_be_chosen_and_an_interrupted_run_goes_on_to_the_same_bytes(
    tmp_path: Path, sharded: Path, deidentified: Path
) -> None:
    root = tmp_path / "dataset"
    make_dataset(root)
    with interrupt_before("redaction/deidentify@1", 2):
        deidentify(root, options(shards=True, executor=HERE))
    assert len(list(root.glob("traversals/*/layers/redaction/deidentify@1"))) == 1
    assert deidentify(root, options(shards=True, executor=HERE)).exit_code() == 0

    def archives(of: Path) -> dict[str, bytes]:
        return {str(path.relative_to(of)): path.read_bytes() for path in of.glob("traversals/*/layers/**/*.tar")}

    assert archives(root) == archives(sharded) and len(archives(root)) == 2
    put_into_shards(Layout(root))
    assert main(["deidentify", str(root), *SEARCH, "--images", "files", "--version", "2"]) == 0
    assert rows_of(root) == rows_of(deidentified)
    assert not [row for row in mirror.open(root).table("images", ["uri"]).to_pylist() if row["uri"].endswith(".tar")]


def test_a_release_of_images_in_shards_is_that_of_files(sharded: Path, deidentified: Path, tmp_path: Path) -> None:
    what = ["--name", "marks", "--licence", "CC0-1.0", "--contact", "a@example.org", "--sample", "0", "--keep-ids"]
    for name, root in (("shards", sharded), ("files", deidentified)):
        assert main(["release", "build", str(root), *what, "--out", str(tmp_path / name)]) == 0
        assert main(["release", "check", str(tmp_path / name), "--originals", str(root)]) == 0
    images = [
        {str(path.relative_to(tmp_path / name)): path.read_bytes() for path in (tmp_path / name).rglob("recorded/*/*")}
        for name in ("shards", "files")
    ]
    assert images[0] == images[1] and len(images[0]) == 18
    session = ReviewSession(sharded, "anna", 5)
    assert len(session.sample) == 5
    for record in session.sample:
        data = session.image(record.out_sha256)
        assert data is not None and hashlib.sha256(data).hexdigest() == record.out_sha256


def test_metadata_of_an_image_in_a_shard_is_found(tmp_path: Path, marks: None) -> None:
    root = tmp_path / "dataset"
    make_dataset(root, frames=1)
    assert deidentify(root, options(shards=True, executor=HERE)).exit_code() == 0
    # A layer that somebody wrote with the recorded bytes, which hold EXIF data, at the end of its archive.
    layer = next(root.glob("traversals/a.d0.*/layers/redaction/deidentify@1"))
    recorded = next(root.glob("traversals/a.d0.*/recorded/rear/*.jpg")).read_bytes()
    archive = layer / "images-00000.tar"
    change = {"byte_offset": archive.stat().st_size, "byte_length": len(recorded)}
    archive.write_bytes(archive.read_bytes() + recorded)
    rows = read_table(layer / "images.parquet", IMAGES).to_pylist()
    changed = [{**row, **change} if row["camera"] == "rear" else row for row in rows]
    files = {"images.parquet": encode_rows(changed, IMAGES), "log.jsonl": (layer / "log.jsonl").read_bytes()}
    write_bytes(layer / "images.parquet", files["images.parquet"])
    seal(layer, files, derived_from={})
    build_index(root)
    found = [str(finding) for _, finding in check(root, only=["PRV003"], cost=Cost.IMAGES).findings]
    assert len(found) == 1 and "images-00000.tar holds" in found[0]
