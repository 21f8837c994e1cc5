"""Images that lie elsewhere: ingested without opening one, loaded and checked where they are."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import fsspec
import numpy as np
import pytest

import mirror
from mirror.dataset.layout import Layout
from mirror.errors import DatasetError
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from mirror.integrity import Cost, check
from mirror.schema.files import read_table
from mirror.schema.tables import IMAGES
from tests.builders.bucket import BUCKET
from tests.builders.folder import SCENE, write_recording
from tests.builders.s3 import served_bucket
from tests.wheels import install_plugins

HASHED, TAGGED = WriteOptions(references="sha256"), WriteOptions(references="etag")


@pytest.fixture
def bucket() -> Iterator[fsspec.AbstractFileSystem]:
    memory = fsspec.filesystem("memory")
    yield memory
    memory.rm("/fleet", recursive=True)


@pytest.fixture
def drive(tmp_path: Path, bucket: fsspec.AbstractFileSystem) -> Path:
    """A recording whose rear camera's images have been put into a bucket."""
    path = write_recording(tmp_path / "fleet", "there")
    folder = path / "images" / "rear"
    lines = ["uri,exposure_start_ns,exposure_end_ns,byte_length,width_px,height_px"]
    for file in sorted(folder.iterdir()):
        bucket.pipe(f"/fleet/rear/{file.name}", file.read_bytes())
        stamp = int(file.stem)
        size = file.stat().st_size
        lines.append(f"memory://fleet/rear/{file.name},{stamp - 1000},{stamp + 1000},{size},64,48")
        (path / "kept" / file.name).parent.mkdir(exist_ok=True)
        file.rename(path / "kept" / file.name)
    folder.rmdir()
    (path / "images" / "rear.csv").write_text("\n".join(lines) + "\n")
    return path


def rear_rows(dataset: Path, traversal_id: str) -> list[dict[str, object]]:
    rows = read_table(Layout(dataset).recorded(traversal_id) / "images.parquet", IMAGES).to_pylist()
    return [row for row in rows if row["camera"] == "rear"]


def ids_of(dataset: Path) -> set[str]:
    return {rule.rule_id for rule, _ in check(dataset, cost=Cost.IMAGES).findings}


def test_they_are_referred_to_and_loaded_from_where_they_are(
    drive: Path, tmp_path: Path, bucket: fsspec.AbstractFileSystem
) -> None:
    report = ingest_recordings([drive], [SCENE], tmp_path / "d")
    assert not report.failures
    rows = rear_rows(tmp_path / "d", report.traversals[0].traversal_id)
    assert rows and all(str(row["uri"]).startswith("memory://fleet/rear/") for row in rows)
    assert {row["sha256"] for row in rows} == {None}
    assert {(row["width_px"], row["height_px"], row["codec"]) for row in rows} == {(64, 48, "jpeg")}
    assert not (Layout(tmp_path / "d").recorded(report.traversals[0].traversal_id) / "rear").exists()
    image = mirror.open(tmp_path / "d").frames()[3].images["rear"]
    expected = cv2.imread(str(drive / "kept" / f"{image.timestamp_ns}.jpg"), cv2.IMREAD_COLOR_RGB)
    np.testing.assert_allclose(image.decode(verify=True).astype(int), expected, atol=2)


def test_none_is_opened_by_ingest_or_its_verification(
    drive: Path, tmp_path: Path, bucket: fsspec.AbstractFileSystem, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(type(bucket), "cat_file", lambda *_, **__: pytest.fail("opened an image"))
    report = ingest_recordings([drive], [SCENE], tmp_path / "d")
    assert not report.failures and len(report.traversals) == 1
    again = ingest_recordings([drive], [SCENE], tmp_path / "d", IngestOptions(verify=True))
    assert again.unchanged == ["there"] and not again.failures


def test_truth_beside_a_recording_is_not_part_of_it(drive: Path, tmp_path: Path) -> None:
    ingest_recordings([drive], [SCENE], tmp_path / "d")
    (drive / "truth").mkdir()
    (drive / "truth" / "poses.parquet").write_bytes(b"exact")
    assert ingest_recordings([drive], [SCENE], tmp_path / "d").unchanged == ["there"]


def test_check_finds_what_is_missing_or_short_there(
    drive: Path, tmp_path: Path, bucket: fsspec.AbstractFileSystem
) -> None:
    out = tmp_path / "d"
    report = ingest_recordings([drive], [SCENE], out)
    rows = rear_rows(out, report.traversals[0].traversal_id)
    assert not {rule for rule in ids_of(out) if rule.startswith("IMG")} - {"IMG007", "IMG009", "IMG013"}
    first, second, third, fourth = (f"/fleet/rear/{row['timestamp_ns']}.jpg" for row in rows[:4])
    bucket.rm(first)
    bucket.pipe(second, bucket.cat_file(second)[:100])
    bucket.pipe(third, b"x" * (len(bucket.cat_file(third)) - 2) + b"\xff\xd9")
    bucket.pipe(fourth, bucket.cat_file(fourth)[:-2] + b"..")
    assert {"IMG001", "IMG002", "IMG003", "IMG005"} <= ids_of(out)


def test_a_uri_that_nothing_here_reads_is_named(drive: Path, tmp_path: Path) -> None:
    table = drive / "images" / "rear.csv"
    table.write_text(table.read_text().replace("memory://", "nowhere-known://"))
    ingest_recordings([drive], [SCENE], tmp_path / "d")
    image = mirror.open(tmp_path / "d").frames()[3].images["rear"]
    with pytest.raises(DatasetError, match="nowhere-known"):
        image.decode()
    assert "IMG001" in ids_of(tmp_path / "d")


def test_hashes_are_kept_of_bytes_that_are_read_once(
    drive: Path, tmp_path: Path, bucket: fsspec.AbstractFileSystem
) -> None:
    out = tmp_path / "d"
    report = ingest_recordings([drive], [SCENE], out, IngestOptions(write=WriteOptions(references="sha256")))
    rows = rear_rows(out, report.traversals[0].traversal_id)
    for row in rows:
        assert row["sha256"] == hashlib.sha256(bucket.cat_file(str(row["uri"]).removeprefix("memory:/"))).digest()
    assert not {"IMG013", "IMG004"} & ids_of(out)
    first, second = (f"/fleet/rear/{row['timestamp_ns']}.jpg" for row in rows[:2])
    changed = bytearray(bucket.cat_file(first))
    changed[-9] ^= 1
    bucket.pipe(first, bytes(changed))
    bucket.pipe(second, bucket.cat_file(second) + b"more")
    frames = mirror.open(out).where(camera="rear").frames()
    found = [frame.images["rear"] for frame in (frames[n] for n in range(4)) if "rear" in frame.images]
    images = [one for row in rows[:2] for one in found if one.uri == row["uri"]]
    with pytest.raises(DatasetError, match="differ from the recorded ones"):
        images[0].read(verify=True)
    with pytest.raises(DatasetError, match=r"has more than .* bytes: it was changed since it was ingested") as caught:
        images[1].read()
    assert caught.value.file == rows[1]["uri"] and str(rows[1]["timestamp_ns"]) in str(caught.value.place)
    assert {"IMG002", "IMG004"} <= ids_of(out)
    (failure,) = ingest_recordings([drive], [SCENE], tmp_path / "e", IngestOptions(write=HASHED)).failures
    assert "expected" in str(failure[1]) and failure[1].file == rows[1]["uri"]


def test_tags_are_kept_where_the_bytes_are_not_read(
    drive: Path, tmp_path: Path, bucket: fsspec.AbstractFileSystem
) -> None:
    (failure,) = ingest_recordings([drive], [SCENE], tmp_path / "e", IngestOptions(write=TAGGED)).failures
    assert "gives no ETag" in str(failure[1]) and "--references sha256" in str(failure[1])
    table, out = drive / "images" / "rear.csv", tmp_path / "d"
    table.write_text(table.read_text().replace("memory://fleet/", f"s3://{BUCKET}/"))
    with served_bucket() as served:
        for file in (drive / "kept").iterdir():
            served.objects[f"rear/{file.name}"] = file.read_bytes()
        report = ingest_recordings([drive], [SCENE], out, IngestOptions(write=TAGGED))
        assert not report.failures and served.count("HEAD") == len(served.requests)
        rows = rear_rows(out, report.traversals[0].traversal_id)
        assert {row["sha256"] for row in rows} == {None}
        assert {"IMG013"} <= ids_of(out) and not {"IMG001", "IMG002"} & ids_of(out)
        (finding,) = [found for rule, found in check(out, only=["IMG013"]).findings]
        assert finding.count == len(rows) and "unverified" in finding.message
        frames = mirror.open(out).frames()
        assert all(frame.images["rear"].decode().shape == (48, 64, 3) for frame in frames if "rear" in frame.images)
        # The same size, other bytes: the request itself is refused.
        key = f"rear/{frames[3].images['rear'].timestamp_ns}.jpg"
        served.objects[key] = served.objects[key][:-9] + b"_" + served.objects[key][-8:]
        served.requests.clear()
        with pytest.raises(DatasetError, match="another ETag: it was changed since it was ingested"):
            mirror.open(out).frames()[3].images["rear"].decode()
        with pytest.raises(DatasetError, match="another ETag"):
            [frame.decode() for frame in mirror.open(out).frames()]
        assert {request.status for request in served.requests if request.key == key} == {412}
        found = [one for rule, one in check(out).findings if rule.rule_id == "IMG002"]
        assert [one.count for one in found] == [1] and "has the ETag" in found[0].message


def find_weather(images: Sequence[np.ndarray]) -> str:
    return "rain" if {image.shape for image in images} == {(48, 64, 3)} else "fog"


def test_weather_is_asked_of_images_elsewhere(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install_plugins(monkeypatch, tmp_path / "site", "mirror.weather", ("some", f"{__name__}:find_weather"))
    document = json.loads((drive / "recording.json").read_text())
    document |= {"reference_camera": "rear", "weather": None}
    (drive / "recording.json").write_text(json.dumps(document))
    ingest_recordings([drive], [SCENE], tmp_path / "d", IngestOptions(weather_plugin="some"))
    assert mirror.open(tmp_path / "d").table("traversals").column("weather").to_pylist() == ["rain"]
