"""What ingest takes over besides poses and files: videos, boxes, weather, light."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

import mirror
from mirror.dataset.layout import Layout
from mirror.dataset.splits import make_split
from mirror.errors import UsageError
from mirror.ingest.passes import DriveContent
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.integrity import check
from mirror.recordings.registry import open_recording
from mirror.schema.documents import NovelTraversal, SplitDocument
from mirror.schema.files import read_table, write_table
from mirror.schema.tables import BOXES, IMAGES
from tests.builders.folder import SCENE, START_NS, write_recording
from tests.wheels import install_plugins


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    return write_recording(tmp_path / "fleet", "there")


def test_frames_of_a_video_are_decoded_only_inside_passes(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    av = pytest.importorskip("av")
    stamps = sorted(int(path.stem) for path in (drive / "images" / "rear").iterdir())
    for path in (drive / "images" / "rear").iterdir():
        path.unlink()
    (drive / "images" / "rear").rmdir()
    (drive / "videos").mkdir()
    with av.open(str(drive / "videos" / "rear.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=10, options={"g": "10", "bf": "0"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for number in range(len(stamps)):
            image = np.full((48, 64, 3), 40 + number, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, "rgb24")))
        container.mux(stream.encode())
    with av.open(str(drive / "videos" / "rear.mp4")) as container:
        pts = sorted(packet.pts for packet in container.demux(video=0) if packet.pts is not None)
    table = "pts,exposure_start_ns,exposure_end_ns\n" + "".join(f"{p},{t},{t}\n" for p, t in zip(pts, stamps))
    (drive / "videos" / "rear.csv").write_text(table)

    streams = []
    images = DriveContent.images
    monkeypatch.setattr(DriveContent, "images", lambda self: streams.append(images(self)) or streams[-1])
    report = ingest_recordings([drive], [SCENE], tmp_path / "d")
    assert not report.failures
    rows = read_table(Layout(tmp_path / "d").recorded(report.traversals[0].traversal_id) / "images.parquet", IMAGES)
    rear = [row for row in rows.to_pylist() if row["camera"] == "rear"]
    assert {row["timestamp_ns"] for row in rear} == {t for t in stamps if 7.5e9 <= t - START_NS <= 22.5e9}
    content = streams[0]["rear"]
    assert len(rear) <= content.decoded <= len(rear) + 10 < len(stamps)
    dataset = mirror.open(tmp_path / "d")
    for frame in dataset.frames()[::20]:
        image = frame.images["rear"]
        expected = 40 + stamps.index(image.timestamp_ns)
        assert abs(float(image.decode().mean()) - expected) < 3


def test_boxes_of_the_recording_become_a_layer(drive: Path, tmp_path: Path) -> None:
    stamps = [START_NS + int(seconds * 1e9) for seconds in (2, 8, 15, 22, 28)]
    values = {field.name: pa.nulls(5, field.type if field.nullable else pa.float64()) for field in BOXES.schema}
    for name, value in {"qw": 1.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "tx_m": 9.0, "ty_m": 1.0, "tz_m": 0.8}.items():
        values[name] = pa.array([value] * 5)
    for name, value in {"length_m": 4.5, "width_m": 1.9, "height_m": 1.6}.items():
        values[name] = pa.array([value] * 5)
    for name, text in {"track_id": "7", "category": "car", "source": "people", "source_version": "1.2"}.items():
        values[name] = pa.array([text] * 5)
    values["timestamp_ns"] = pa.array(stamps, pa.int64())
    write_table(drive / "boxes.parquet", pa.table(values), BOXES)
    report = ingest_recordings([drive], [SCENE], tmp_path / "d")
    layout, name = Layout(tmp_path / "d"), report.traversals[0].traversal_id
    assert layout.layers(name) == [("boxes", "people", "1.2")]
    rows = read_table(layout.layer(name, "boxes", "people", "1.2") / "boxes.parquet", BOXES)
    assert rows.column("timestamp_ns").to_pylist() == stamps[1:4]
    assert mirror.open(tmp_path / "d").count("boxes") == 3


def test_light_is_computed_from_the_sun_and_weather_is_as_stated(drive: Path, tmp_path: Path) -> None:
    ingest_recordings([drive], [SCENE], tmp_path / "d")
    row = mirror.open(tmp_path / "d").table("traversals").to_pylist()[0]
    # 2023-11-14 22:13:20 UTC in Munich.
    assert (row["light"], row["light_source"]) == ("night", "solar_elevation")
    assert (row["weather"], row["weather_source"]) == ("clear", "metadata")
    document = json.loads((drive / "recording.json").read_text())
    (drive / "recording.json").write_text(json.dumps({**document, "light": "dusk"}))
    ingest_recordings([drive], [SCENE], tmp_path / "e")
    row = mirror.open(tmp_path / "e").table("traversals").to_pylist()[0]
    assert (row["light"], row["light_source"]) == ("dusk", "metadata")


SEEN: list[tuple[int, ...]] = []


def find_rain(images: list[np.ndarray]) -> str:
    SEEN.extend(image.shape for image in images)
    return "rain"


def test_weather_plugin_sees_images_of_drives_that_do_not_state_it(
    drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    document = json.loads((drive / "recording.json").read_text())
    (drive / "recording.json").write_text(json.dumps({**document, "weather": None}))
    assert open_recording(drive).info.weather is None
    install_plugins(monkeypatch, tmp_path / "site", "mirror.weather", ("rainy", f"{__name__}:find_rain"))
    SEEN.clear()
    ingest_recordings([drive], [SCENE], tmp_path / "d", IngestOptions(weather_plugin="rainy"))
    row = mirror.open(tmp_path / "d").table("traversals").to_pylist()[0]
    assert (row["weather"], row["weather_source"]) == ("rain", "rainy")
    assert SEEN == [(48, 64, 3)] * 3
    monkeypatch.undo()
    with pytest.raises(UsageError, match="'no_such'"):
        ingest_recordings([drive], [SCENE], tmp_path / "e", IngestOptions(weather_plugin="no_such"))
    assert not (tmp_path / "e").exists()


def test_the_hash_of_a_dataset_is_of_what_was_recorded_and_not_of_when(tmp_path: Path) -> None:
    """Two machines that ingest the same recordings have the same dataset."""

    def ingested(name: str, change: Callable[[Path], object]) -> tuple[Path, SplitDocument]:
        drives = [
            write_recording(tmp_path / name, drive, start_ns=START_NS + number * 10**12, seed=number)
            for number, drive in enumerate(("first", "second"))
        ]
        change(drives[0])
        assert not ingest_recordings(drives, [SCENE], tmp_path / name / "dataset").failures
        split = make_split(tmp_path / name / "dataset", "s", NovelTraversal(train=1, held_out=1))
        return tmp_path / name / "dataset", split.document

    def touch(drive: Path) -> None:
        for number, path in enumerate(sorted(drive.rglob("*"))):
            os.utime(path, (10**9 + number, 10**9 + number))

    def change_a_byte(drive: Path) -> None:
        image = sorted((drive / "images" / "rear").glob("*.jpg"))[60]
        data = bytearray(image.read_bytes())
        data[len(data) // 2] ^= 1
        image.unlink()
        image.write_bytes(data)

    (here, first), (there, same), (_, other) = (
        ingested("here", lambda drive: None),
        ingested("there", touch),
        ingested("other", change_a_byte),
    )
    assert (here / "drives/first/manifest.json").read_bytes() != (there / "drives/first/manifest.json").read_bytes()
    assert first == same
    assert first.assignments == other.assignments
    assert first.dataset_hash != other.dataset_hash
    # Nor is a split stale where the same recordings were ingested again.
    shutil.copytree(here / "splits", there / "splits", dirs_exist_ok=True)
    assert [rule.rule_id for rule, _ in check(there, only=("SPL007",)).findings] == []
