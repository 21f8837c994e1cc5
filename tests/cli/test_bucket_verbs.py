"""Verbs on a dataset in a bucket: the reports and the bytes of a folder, and a refusal where only a folder will do."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import mirror
from mirror.annotation.run import annotate
from mirror.cli.main import main
from mirror.dataset.garbage import collect_garbage
from mirror.dataset.index import build_index
from mirror.errors import DatasetError, MirrorError, UsageError
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from mirror.integrity import check
from mirror.integrity.finding import Cost
from mirror.privacy.options import DeidentifyOptions
from mirror.privacy.run import deidentify
from tests.builders.bucket import BUCKET, Bucket
from tests.builders.folder import SCENE, START_NS, write_recording
from tests.builders.s3 import moto_bucket, served_bucket

URL = f"s3://{BUCKET}/street"
LEASE = "street/.lease.json"
FILES = IngestOptions(workers=1, write=WriteOptions(transfer="copy"))


@pytest.fixture(scope="module")
def grown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder to which two runs have added a drive each, and what a killed run left of a third one."""
    root = tmp_path_factory.mktemp("grown")
    for number in range(2):
        drive = write_recording(root, f"drive_{number}", start_ns=START_NS + number * 10**13, from_m=-70.0, to_m=70.0)
        ingest_recordings([drive], [SCENE], root / "street", FILES)
    left = root / "street" / "traversals" / "street.gone.1" / "recorded" / "rear"
    left.mkdir(parents=True)
    (left / "1.jpg").write_bytes(b"left")
    return root / "street"


@pytest.fixture
def bucket() -> Iterator[Bucket]:
    with served_bucket() as served:
        yield served


def copy_to(bucket: Bucket, folder: Path) -> None:
    bucket.objects.clear()
    bucket.requests.clear()
    for path in folder.rglob("*"):
        if path.is_file():
            bucket.objects[f"street/{path.relative_to(folder).as_posix()}"] = path.read_bytes()


def say(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, dict[str, Any]]:
    """Exit code and report of a verb, without what names the place or the time it took."""
    code = main([*words, "--json"])
    report = json.loads(capsys.readouterr().out)
    return code, {key: value for key, value in report.items() if key not in ("path", "dataset", "seconds")}


def test_info_and_check_say_of_a_bucket_what_they_say_of_a_folder(
    grown: Path, bucket: Bucket, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "folder"
    shutil.copytree(grown, folder)
    copy_to(bucket, folder)
    before = dict(bucket.objects)
    here = say(capsys, "info", str(folder))
    assert here == say(capsys, "info", URL) and here[1]["index"] == "current" and here[1]["traversals"] == 2
    copied = {request.key for request in bucket.requests if request.method == "GET" and request.key}
    assert not any(key.endswith((".jpg", "images.parquet")) for key in copied)
    bucket.requests.clear()
    found = say(capsys, "check", URL, "--full")
    assert found == say(capsys, "check", str(folder), "--full")
    assert any("street.gone.1" in finding["file"] for finding in found[1]["findings"])
    assert {request.method for request in bucket.requests} <= {"GET", "HEAD"} and bucket.objects == before
    # Sizes come with the list of objects.
    assert not any(request.method == "HEAD" and request.key.endswith(".jpg") for request in bucket.requests)
    (recorded,) = (folder / "traversals").glob("*.drive_0.*/recorded")
    images = sorted((recorded / "rear").iterdir())
    images[0].unlink()
    images[1].write_bytes(images[1].read_bytes()[:-7])
    (recorded / "ego_poses.parquet").write_bytes(b"x" * 10)
    (folder / "drives" / "drive_1" / "manifest.json").unlink()
    copy_to(bucket, folder)
    code, report = say(capsys, "check", URL)
    assert (code, report) == say(capsys, "check", str(folder))
    assert code == 1 and {"FIL002", "IMG001", "IMG002"} <= {one["rule"] for one in report["findings"]}


def test_an_index_that_is_made_compact_in_a_bucket_has_the_bytes_of_a_folder(
    grown: Path, bucket: Bucket, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "folder"
    shutil.copytree(grown, folder)
    copy_to(bucket, folder)
    _, there = say(capsys, "index", URL, "--compact")
    _, here = say(capsys, "index", str(folder), "--compact")
    assert there == here and (there["snapshot"], there["segments"]) == (3, 1)
    assert {key.removeprefix("street/"): data for key, data in bucket.objects.items()} == {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }
    puts = [request for request in bucket.requests if request.method == "PUT"]
    assert puts[-1].key.endswith("00000003.json") and all(put.headers["if-none-match"] == "*" for put in puts)
    # Up to date: nothing is put. An object that was lost is put again; one that was changed is named.
    bucket.requests.clear()
    assert say(capsys, "index", URL)[1]["snapshot"] == 3 and not bucket.count("PUT")
    (segment,) = {segment.name for segment in mirror.open(folder).catalog.snapshot.segments}
    table = f"street/index/{segment}/frames/street.parquet"
    data = bucket.objects.pop(table)
    assert say(capsys, "index", URL)[0] == 0 and bucket.objects[table] == data
    bucket.objects[table] = data[:-1]
    assert main(["index", URL]) == 2
    assert f"remove index/{segment}/frames/ in the bucket" not in (said := capsys.readouterr().err)
    assert f"remove index/{segment}/ in the bucket" in said


def test_gc_removes_from_a_bucket_what_it_removes_from_a_folder(
    grown: Path, bucket: Bucket, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "folder"
    shutil.copytree(grown, folder)
    build_index(folder, compact=True)
    copy_to(bucket, folder)
    before = dict(bucket.objects)
    # All objects of this server were written long ago.
    _, planned = say(capsys, "dataset", "gc", URL, "--dry-run")
    assert {**bucket.objects, **before} == bucket.objects and bucket.objects.keys() - before == {LEASE}
    _, done = say(capsys, "dataset", "gc", URL)
    report = collect_garbage(folder, age_s=0.0)
    assert planned | {"dry_run": False} == done
    assert (done["snapshots"], done["traversals"], done["bytes"]) == ([1, 2], ["street.gone.1"], report.bytes)
    assert sorted(done["segments"]) == sorted(report.segments) and len(done["segments"]) == 2
    left = {f"street/{path.relative_to(folder).as_posix()}" for path in folder.rglob("*") if path.is_file()}
    assert bucket.objects.keys() - {LEASE} == left - {LEASE}
    assert mirror.open(URL).drives() == ["drive_0", "drive_1"]
    # A manifest that cannot be read may name anything: nothing is removed.
    bucket.objects["street/drives/drive_0/manifest.json"] = b"{"
    bucket.objects["street/traversals/street.other.1/recorded/1.jpg"] = b"left"
    assert main(["dataset", "gc", URL]) == 2
    assert "street/traversals/street.other.1/recorded/1.jpg" in bucket.objects


def test_gc_keeps_what_is_young_in_another_implementation_of_s3(
    grown: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with moto_bucket():
        import s3fs

        remote = s3fs.S3FileSystem()
        for path in grown.rglob("*"):
            if path.is_file():
                remote.pipe_file(f"{BUCKET}/street/{path.relative_to(grown).as_posix()}", path.read_bytes())
        assert say(capsys, "index", URL, "--compact")[1]["segments"] == 1
        assert say(capsys, "dataset", "gc", URL, "--older-than-days", "0.5")[1]["bytes"] == 0
        done = say(capsys, "dataset", "gc", URL, "--older-than-days", "0")[1]
        assert (done["snapshots"], done["traversals"]) == ([1, 2], ["street.gone.1"])
        assert not [rule.rule_id for rule, _ in check(URL, only=["FIL", "IDX"], cost=Cost.IMAGES).findings]
        assert say(capsys, "info", URL)[1]["drives"] == 2


@pytest.mark.parametrize(
    "words",
    [
        ["annotate", URL, "--annotator", "file", "--set", "path=a.json"],
        ["annotate", "track", URL, "--boxes", "a@1"],
        ["deidentify", URL, "--plate-region", "CN"],
        ["calibrate", "refine", URL],
        ["split", URL, "novel"],
        ["dataset", "migrate", URL],
    ],
)
def test_what_writes_layers_or_splits_is_refused_at_once_with_the_way_out(
    words: list[str], bucket: Bucket, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(words) == 2
    said = capsys.readouterr().err
    assert URL in said and "mirror dataset fetch URL --scene ID --out FOLDER" in said
    assert not bucket.requests


class Never:
    """An annotator that must not be asked."""

    name, version, fingerprint = "never", "1", "never"

    def annotate(self, frame: object) -> object:
        raise AssertionError("the bucket cannot take its layer")


def test_functions_that_write_layers_refuse_a_bucket_before_they_begin(grown: Path, bucket: Bucket) -> None:
    copy_to(bucket, grown)
    calls: list[tuple[type[MirrorError], Any]] = [
        (UsageError, lambda: annotate(mirror.open(URL), Never())),  # type: ignore[arg-type]
        (DatasetError, lambda: deidentify(URL, DeidentifyOptions())),
    ]
    for kind, call in calls:
        with pytest.raises(kind, match=f"mirror dataset fetch {URL} --scene ID --out FOLDER"):
            call()
    assert not bucket.count("PUT")
