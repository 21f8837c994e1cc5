"""Ingest into a bucket: the bytes of an ingest into a folder, whatever interrupts it, in few requests."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.index.snapshots import list_snapshots
from mirror.dataset.store import Store
from mirror.errors import DatasetError, MirrorError, UsageError
from mirror.executors.choice import ExecutorChoice
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from tests.builders.bucket import BUCKET, Bucket
from tests.builders.folder import SCENE, START_NS, tree, write_recording
from tests.builders.s3 import moto_bucket, served_bucket
from tests.ingest import hooks

OUT = f"s3://{BUCKET}/street"
READER = f"{Path(hooks.__file__).relative_to(Path.cwd())}:HookedReader"
SHARDS = IngestOptions(workers=1, write=WriteOptions(transfer="copy", shards=True))


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    root = tmp_path_factory.mktemp("fleet")
    return [write_recording(root, f"drive_{n}", start_ns=START_NS + n * 10**13, seed=n) for n in range(3)]


@pytest.fixture
def bucket() -> Iterator[Bucket]:
    with served_bucket() as served:
        yield served


def contents(bucket: Bucket) -> dict[str, str]:
    """The SHA-256 of all objects but snapshots, by their path in the dataset."""
    found = {key.removeprefix("street/"): data for key, data in sorted(bucket.objects.items())}
    return {
        key: hashlib.sha256(data).hexdigest() for key, data in found.items() if not key.startswith("index/snapshots/")
    }


def test_a_bucket_gets_the_bytes_that_a_folder_gets(fleet: list[Path], bucket: Bucket, tmp_path: Path) -> None:
    for number, drives in enumerate((fleet[:2], fleet)):
        ingest_recordings(drives, [SCENE], tmp_path / "folder", SHARDS)
        report = ingest_recordings(drives, [SCENE] if not number else [], OUT, SHARDS)
        assert not report.failures and len(report.unchanged) == 2 * number
        assert contents(bucket) == tree(tmp_path / "folder")
    puts = [request for request in bucket.requests if request.method == "PUT"]
    assert all(put.headers["if-none-match"] == "*" for put in puts)
    # A manifest comes after what it lists, and the snapshot last.
    keys = [put.key.removeprefix("street/") for put in puts if put.status == 200]
    assert keys[:2] == ["rois.geojson", "dataset.json"] and keys[-1] == "index/snapshots/00000002.json"
    for key in keys:
        if key.endswith("manifest.json"):
            folder = key.removesuffix("manifest.json")
            assert max(at for at, other in enumerate(keys) if other.startswith(folder)) == keys.index(key)
    here, there = mirror.open(tmp_path / "folder"), mirror.open(OUT)
    assert there.index_sha256 == here.index_sha256
    for one, other in zip(here.frames()[::20], there.frames()[::20]):
        assert [image.read() for image in one.images.values()] == [
            image.read(verify=True) for image in other.images.values()
        ]


def test_a_run_that_is_refused_at_any_put_is_repeated_to_the_same_bytes(
    fleet: list[Path], bucket: Bucket, tmp_path: Path
) -> None:
    ingest_recordings(fleet[:1], [SCENE], tmp_path / "folder", SHARDS)
    count = len(tree(tmp_path / "folder"))
    for put in range(0, count, 4):
        # The conditional puts before this one are done or found done; this one is refused for good.
        bucket.refusals = [200] * put + [403]
        with pytest.raises(MirrorError, match="AWS_ACCESS_KEY_ID"):
            ingest_recordings(fleet[:1], [SCENE], OUT, SHARDS)
        bucket.refusals = []
        assert not list_snapshots(Store(OUT))
    ingest_recordings(fleet[:1], [SCENE], OUT, SHARDS)
    assert contents(bucket) == tree(tmp_path / "folder")


def test_runs_that_write_one_bucket_at_the_same_time_all_get_their_snapshot(fleet: list[Path], bucket: Bucket) -> None:
    ingest_recordings(fleet[:1], [SCENE], OUT, SHARDS)
    failed: list[object] = []

    def add(drive: Path) -> None:
        try:
            failed.extend(ingest_recordings([drive], [], OUT, SHARDS).failures)
        except MirrorError as error:
            failed.append(error)

    runs = [threading.Thread(target=add, args=(drive,)) for drive in fleet[1:]]
    for run in runs:
        run.start()
    for run in runs:
        run.join(60)
    assert not failed and mirror.open(OUT).drives() == ["drive_0", "drive_1", "drive_2"]
    assert list_snapshots(Store(OUT)) == [1, 2, 3]


def test_what_would_replace_files_is_refused(fleet: list[Path], bucket: Bucket, tmp_path: Path) -> None:
    ingest_recordings(fleet[:1], [SCENE], OUT, SHARDS)
    before = contents(bucket)
    for options in (IngestOptions(replace=True), IngestOptions(verify=True)):
        with pytest.raises(UsageError, match="only a dataset in a folder is changed"):
            ingest_recordings(fleet[:1], [], OUT, options)
    other = SCENE.model_copy(update={"scene_id": "other", "longitude_deg": 3.0})
    with pytest.raises(DatasetError, match=r"rois\.geojson: the dataset in the bucket has another one"):
        ingest_recordings(fleet[:1], [other], OUT, SHARDS)
    changed = write_recording(tmp_path, "drive_0", start_ns=START_NS, seed=9, speed_mps=7.0)
    (failure,) = ingest_recordings([changed], [], OUT, SHARDS).failures
    assert "from other files or with other options" in str(failure[1])
    with pytest.raises(UsageError, match="nothing is written to this store"):
        ingest_recordings(fleet[:1], [SCENE], "memory://street", SHARDS)
    assert contents(bucket) == before


def test_processes_that_are_killed_put_the_bytes_of_one_process(bucket: Bucket, tmp_path: Path) -> None:
    fleet = [
        write_recording(tmp_path, f"drive_{n}", start_ns=START_NS + n * 10**13, from_m=-70.0, to_m=70.0, seed=n)
        for n in range(2)
    ]
    options = replace(SHARDS, reader=READER, timeout_s=60.0)
    ingest_recordings(fleet, [SCENE], tmp_path / "folder", options)
    for recording, pattern in zip(fleet, ("recorded/*.tar", "recorded/images.parquet drives/*/passes.parquet")):
        recording.with_name(f"{recording.name}.{hooks.KILL_AT_READING}").write_text(pattern)
    jobs = replace(options, executor=ExecutorChoice("processes", 2))
    report = ingest_recordings(fleet, [SCENE], OUT, jobs)
    assert sorted(report.drives) == ["drive_0", "drive_1"] and not report.failures
    assert len(list(tmp_path.glob("*.killed"))) == 3
    assert contents(bucket) == tree(tmp_path / "folder")
    puts = [request for request in bucket.requests if request.method == "PUT" and request.status == 200]
    assert puts[-1].key.endswith("index/snapshots/00000001.json") and len(puts) == len(bucket.objects)
    # Drives that a run committed before it was killed itself are found done, and get their snapshot.
    del bucket.objects["street/index/snapshots/00000001.json"]
    again = ingest_recordings(fleet, [], OUT, replace(jobs, executor=ExecutorChoice("serial")))
    assert sorted(again.drives) == ["drive_0", "drive_1"] and mirror.open(OUT).drives() == ["drive_0", "drive_1"]
    assert contents(bucket) == tree(tmp_path / "folder")


def test_opening_asks_at_most_ten_times_with_four_thousand_snapshots(fleet: list[Path], bucket: Bucket) -> None:
    ingest_recordings(fleet[:1], [SCENE], OUT, SHARDS)
    newest = bucket.objects["street/index/snapshots/00000001.json"]
    for count, most in ((40, 3), (4_000, 10)):
        for number in range(2, count + 1):
            bucket.objects[f"street/index/snapshots/{number:08d}.json"] = newest
        bucket.requests.clear()
        dataset = mirror.open(OUT)
        assert dataset.snapshot == count and bucket.count() <= most
    assert dataset.drives() == ["drive_0"]


def test_another_implementation_of_s3_gives_the_same_dataset(
    fleet: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with moto_bucket():
        place = f"{SCENE.longitude_deg},{SCENE.latitude_deg},60,street"
        words = ["ingest", str(fleet[0]), "--roi", place, "--images", "shards", "--out"]
        assert (
            main([*words[:-1], "--executor", "processes", "--workers", "1", "--out", OUT]) == 0
            and main([*words, str(tmp_path / "folder")]) == 0
        )
        assert "s3://fleet/street" in capsys.readouterr().out
        assert main([*words, OUT]) == 0
        assert "1 unchanged drives were skipped" in capsys.readouterr().out
        assert mirror.open(OUT).index_sha256 == mirror.open(tmp_path / "folder").index_sha256
        image = mirror.open(OUT).frames()[5].images["rear"]
        assert image.decode(verify=True).shape == (48, 64, 3)
