"""Images side by side in tar archives: other programs open them, and they read as files do."""

from __future__ import annotations

import tarfile
from pathlib import Path

import pyarrow as pa
import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.images.shards import ShardWriter, frames_in_order
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from mirror.integrity import Cost, check
from tests.builders.folder import SCENE, START_NS, tree, write_recording

SHARDS = IngestOptions(workers=1, write=WriteOptions(shards=True))


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    root = tmp_path_factory.mktemp("fleet")
    return [write_recording(root, f"d{number}", start_ns=START_NS + number * 10**13, seed=number) for number in (0, 1)]


def test_a_dataset_of_shards_reads_as_one_of_files(drives: list[Path], tmp_path: Path) -> None:
    ingest_recordings(drives, [SCENE], tmp_path / "files")
    ingest_recordings(drives, [SCENE], tmp_path / "shards", SHARDS)
    place = f"{SCENE.longitude_deg},{SCENE.latitude_deg},60,street"
    words = ["--out", str(tmp_path / "again"), "--images", "shards", "--roi", place]
    assert main(["ingest", *map(str, drives), *words]) == 0
    files, shards = mirror.open(tmp_path / "files"), mirror.open(tmp_path / "shards")
    assert len(shards.frames()) == len(files.frames()) > 40
    for one, other in zip(files.frames(), shards.frames()):
        assert {name: image.read() for name, image in one.images.items()} == {
            name: image.read(verify=True) for name, image in other.images.items()
        }
    columns = [name for name in files.table("images").column_names if name not in ("uri", "byte_offset")]
    assert shards.table("images", columns) == files.table("images", columns)
    assert not list((tmp_path / "shards").rglob("*.jpg"))
    counts = check(tmp_path / "shards", cost=Cost.IMAGES).counts()
    assert (counts["error"], counts["warning"]) == (0, 0)
    assert {name: sha256 for name, sha256 in tree(tmp_path / "again").items() if name.endswith(".tar")} == {
        name: sha256 for name, sha256 in tree(tmp_path / "shards").items() if name.endswith(".tar")
    }


def test_a_shard_is_a_tar_archive_whose_frames_follow_each_other(drives: list[Path], tmp_path: Path) -> None:
    ingest_recordings(drives[:1], [SCENE], tmp_path / "shards", SHARDS)
    dataset = mirror.open(tmp_path / "shards")
    (path,) = (tmp_path / "shards").rglob("*.tar")
    with tarfile.open(path) as archive:
        opened = {member.name: archive.extractfile(member) for member in archive}
        read = {name: file.read() for name, file in opened.items() if file is not None}
        offsets = [member.offset_data for member in archive.getmembers()]
    expected = [image for frame in dataset.frames() for image in frame.images.values()]
    names = [f"{image.camera}/{image.timestamp_ns}.jpg" for image in expected]
    assert [name for name in read if name in names] == names
    assert [read[name] for name in names] == [image.read() for image in expected]
    assert sorted(row["byte_offset"] for row in dataset.table("images", ["byte_offset"]).to_pylist()) == offsets


def test_a_frame_is_in_one_shard_and_shards_are_no_larger_than_asked(tmp_path: Path) -> None:
    writer = ShardWriter(tmp_path, limit_bytes=10_000)
    frames = [[(f"{camera}/{frame}.jpg", bytes([frame]) * 1500) for camera in "abc"] for frame in range(5)]
    places = [writer.write_frame(frame) for frame in frames]
    writer.close()
    # Three images take 3 * (512 + 1536) bytes.
    assert [{place.shard for place in frame} for frame in places] == [{f"images-{n:05d}.tar"} for n in range(5)]
    single = writer.write_frame([("big", bytes(20_000))])
    writer.close()
    assert single[0].shard == "images-00005.tar" and (tmp_path / single[0].shard).stat().st_size > 20_000
    for frame, own in zip(frames, places):
        for (name, data), place in zip(frame, own):
            assert (tmp_path / place.shard).read_bytes()[place.offset :][: len(data)] == data, name


def test_an_image_without_a_frame_follows_the_frame_before_it() -> None:
    images = pa.table(
        {
            "camera": ["rear", "front", "front", "rear", "rear"],
            "timestamp_ns": [5, 10, 20, 14, 21],
            "frame_index": pa.array([None, 0, 1, None, 1], pa.int32()),
        }
    )
    assert list(frames_in_order(images, range(5))) == [[0], [1], [3], [2, 4]]
