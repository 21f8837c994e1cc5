"""A part of a dataset that is fetched: a dataset of its own, which passes its check and has the bytes of the whole."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.images.binary_mask import encode_mask
from mirror.dataset.index import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout
from mirror.errors import DatasetError, UsageError
from mirror.export.part import fetch_part
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from mirror.integrity import check
from mirror.schema.tables import MASKS
from tests.builders.bucket import BUCKET, Bucket
from tests.builders.folder import SCENE, START_NS, tree, write_recording
from tests.builders.s3 import served_bucket

URL = f"s3://{BUCKET}/whole"
OTHER = SCENE.model_copy(update={"scene_id": "west", "longitude_deg": SCENE.longitude_deg - 0.0002})


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("part")
    drives = [write_recording(root / "fleet", f"d{n}", start_ns=START_NS + n * 10**13, seed=n) for n in (0, 1)]
    options = IngestOptions(write=WriteOptions(shards=True), licence="CC0-1.0")
    ingest_recordings(drives, [SCENE, OTHER], root / "whole", options)
    dataset, layout = mirror.open(root / "whole"), Layout(root / "whole")
    for name in dataset.traversals():
        writer = LayerWriter(layout, name, "masks", "hand", "1")
        rows = []
        for row in dataset.where(traversal=name).table("images", ["camera", "timestamp_ns"]).to_pylist()[::30]:
            data = encode_mask(np.ones((48, 64), np.uint8))
            rows.append({**row, "kind": "sky", **writer.file(f"{row['camera']}/{row['timestamp_ns']}.png", data)})
        writer.finish(MASKS, rows)
    build_index(root / "whole")
    return root / "whole"


@pytest.fixture
def bucket(whole: Path) -> Iterator[Bucket]:
    with served_bucket() as served:
        for path in whole.rglob("*"):
            if path.is_file():
                served.objects[path.relative_to(whole.parent).as_posix()] = path.read_bytes()
        yield served


@pytest.mark.parametrize("cameras", [["rear"], ["front_wide"], []])
def test_a_part_out_of_a_bucket_is_a_dataset_that_passes_its_check(
    cameras: list[str], bucket: Bucket, whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["dataset", "fetch", URL, "--scene", "west", "--out", str(tmp_path / "part")]
    assert main([*words, *(word for camera in cameras for word in ("--camera", camera))]) == 0
    counts = check(tmp_path / "part", cost=mirror.integrity.Cost.IMAGES).counts()
    assert (counts["error"], counts["warning"]) == (0, 0)
    part, view = mirror.open(tmp_path / "part"), mirror.open(whole).where(scene="west", camera=cameras or None)
    assert part.scenes() == ["west"] and part.cameras() == view.cameras() and part.drives() == view.drives()
    columns = ["traversal_id", "camera", "timestamp_ns", "frame_index", "sha256", "byte_length", "x_m", "privacy"]
    assert part.table("images", columns).to_pylist() == view.table("images", columns).to_pylist()
    columns = ["traversal_id", "camera", "timestamp_ns", "sha256"]
    assert part.table("masks", columns).to_pylist() == view.table("masks", columns).to_pylist() != []
    assert {one["traversal_id"] for one in part.passes().to_pylist()} == set(view.traversals())
    images = [image for frame in part.frames() for image in frame.images.values()]
    assert len(images) > 20 and all(len(image.read(verify=True)) for image in images)
    # Repeated, nothing of a traversal is fetched.
    bucket.requests.clear()
    before = tree(tmp_path / "part")
    assert main([*words, *(word for camera in cameras for word in ("--camera", camera))]) == 0
    assert "2 kept" in capsys.readouterr().out and tree(tmp_path / "part") == before
    assert not [request.key for request in bucket.requests if request.key.endswith(".tar")]


def test_an_interrupted_part_continues_and_another_one_is_refused(bucket: Bucket, tmp_path: Path) -> None:
    shard = sorted(key for key in bucket.objects if key.endswith(".tar"))[-1]
    data = bucket.objects.pop(shard)
    with pytest.raises(DatasetError, match="resumes where it stopped"):
        fetch_part(URL, tmp_path / "part", scenes=["west"])
    bucket.objects[shard] = data[:-9000] + bytes(9000)
    with pytest.raises(DatasetError, match="the bytes differ from the hash"):
        fetch_part(URL, tmp_path / "part", scenes=["west"])
    bucket.objects[shard] = data
    report = fetch_part(URL, tmp_path / "part", scenes=["west"])
    assert (report.traversals, report.kept) == (2, 1)
    with pytest.raises(UsageError, match="another dataset: nothing was written"):
        fetch_part(URL, tmp_path / "part", scenes=["street"])
    with pytest.raises(UsageError, match="no traversal is in this part"):
        fetch_part(URL, tmp_path / "none", lights=["day"])
    assert not (tmp_path / "none").exists()
