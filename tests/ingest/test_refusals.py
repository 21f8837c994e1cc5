"""Wrong data is not taken silently: boxes that are nowhere, images of another raster, images broken inside."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pyarrow.parquet as pq
import pytest

from mirror.dataset.layout import Layout
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.ingest.traversal import WriteOptions
from mirror.schema.files import read_table, write_table
from mirror.schema.tables import BOXES, IMAGES
from tests.fuzz.bases import BASES, Base, image


@pytest.fixture
def base(tmp_path: Path) -> Base:
    return BASES["folder"](tmp_path / "fleet")


def problem(base: Base, tmp_path: Path, write: WriteOptions | None = None) -> str:
    """Return why the recording is refused; nothing is left of it in the dataset."""
    report = ingest_recordings([base.path], [base.roi], tmp_path / "d", IngestOptions(write=write or WriteOptions()))
    assert len(report.failures) == 1, report
    assert not list((tmp_path / "d").glob("traversals/*/recorded/manifest.json"))
    return str(report.failures[0][1])


@pytest.mark.parametrize(
    ("column", "value", "words"),
    [
        ("length_m", float("nan"), "a box of size"),
        ("width_m", -1.9, "a box of size"),
        ("height_m", 0.0, "a box of size"),
        ("tx_m", float("inf"), "a box of centre"),
        ("ty_m", float("nan"), "a box of centre"),
        ("qw", 0.2, "a box of quaternion"),
        ("vx_mps", float("nan"), "a box of velocity"),
        ("score", 1.5, "a box of score"),
    ],
)
def test_boxes_that_are_nowhere(base: Base, tmp_path: Path, column: str, value: float, words: str) -> None:
    file = base.path / "boxes.parquet"
    rows = pq.read_table(file).to_pylist()
    rows[7][column] = value
    write_table(file, BOXES.schema.empty_table().from_pylist(rows, schema=BOXES.schema), BOXES)
    said = problem(base, tmp_path)
    assert words in said and "row 7, track 7" in said


def test_whole_boxes_and_rasters_are_taken(base: Base, tmp_path: Path) -> None:
    report = ingest_recordings([base.path], [base.roi], tmp_path / "d")
    assert not report.failures and report.images > 50
    rows = read_table(Layout(tmp_path / "d").recorded(report.traversals[0].traversal_id) / "images.parquet", IMAGES)
    assert set(zip(rows.column("width_px").to_pylist(), rows.column("height_px").to_pylist())) == {(64, 48)}


@pytest.mark.parametrize("hashing", [True, False])
def test_an_image_of_another_size_than_its_camera(base: Base, tmp_path: Path, hashing: bool) -> None:
    """The twentieth, not the first: every header is read."""
    file = sorted((base.path / "images" / "front_wide").iterdir())[20]
    file.write_bytes(image(".jpg", (48, 64)))
    said = problem(base, tmp_path, WriteOptions(hashing=hashing))
    assert f"{file}: camera front_wide: 48 x 64 px, but its camera is calibrated (factory) for 64 x 48 px" in said


@pytest.mark.parametrize(("mask_px", "is_taken"), [((64, 48), True), ((48, 64), False)])
def test_a_mask_has_the_size_of_the_images(
    base: Base, tmp_path: Path, mask_px: tuple[int, int], is_taken: bool
) -> None:
    document = json.loads((base.path / "recording.json").read_text())
    document["cameras"]["front_wide"]["static_mask"] = "mask.png"
    (base.path / "recording.json").write_text(json.dumps(document))
    width, height = mask_px
    assert cv2.imwrite(str(base.path / "mask.png"), np.full((height, width), 255, np.uint8))
    if is_taken:
        assert not ingest_recordings([base.path], [base.roi], tmp_path / "d").failures
        return
    said = problem(base, tmp_path)
    assert "camera front_wide: 64 x 48 px, but the static mask of its camera has 48 x 64 px" in said


def test_without_a_calibration_every_image_has_its_own_size(base: Base, tmp_path: Path) -> None:
    (base.path / "calibrations" / "factory.json").unlink()
    document = json.loads((base.path / "recording.json").read_text())
    for camera in document["cameras"].values():
        camera["static_mask"] = None
    (base.path / "recording.json").write_text(json.dumps(document))
    file = sorted((base.path / "images" / "front_wide").iterdir())[20]
    file.write_bytes(image(".jpg", (48, 64)))
    report = ingest_recordings([base.path], [base.roi], tmp_path / "d")
    assert not report.failures
    rows = read_table(Layout(tmp_path / "d").recorded(report.traversals[0].traversal_id) / "images.parquet", IMAGES)
    sizes = {row["timestamp_ns"]: (row["width_px"], row["height_px"]) for row in rows.to_pylist()}
    assert sizes.pop(int(file.stem)) == (48, 64)
    assert set(sizes.values()) == {(64, 48)}


def test_foreign_bytes_between_intact_markers(base: Base, tmp_path: Path) -> None:
    file = sorted((base.path / "images" / "front_wide").iterdir())[20]
    data = image(".jpg", (64, 48))
    file.write_bytes(data[:2] + np.random.default_rng(0).bytes(len(data) - 4) + data[-2:])
    assert f"{file}: broken JPEG" in problem(base, tmp_path)


def test_what_only_a_decoder_sees_is_found_on_request(base: Base, tmp_path: Path) -> None:
    """Huffman tables of no code at all: the structure is whole, and no decoder makes an image of it."""
    file = sorted((base.path / "images" / "front_wide").iterdir())[20]
    data = bytearray(file.read_bytes())
    at = data.index(b"\xff\xc4")
    data[at + 5 : at + 21] = bytes([255] * 16)
    file.write_bytes(data)
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) is None
    assert f"{file}: cannot be decoded" in problem(base, tmp_path, WriteOptions(decoding=True))
    report = ingest_recordings([base.path], [base.roi], tmp_path / "e")
    assert not report.failures


def test_the_verb_has_the_option(base: Base, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from mirror.cli.main import main

    file = sorted((base.path / "images" / "front_wide").iterdir())[20]
    data = bytearray(file.read_bytes())
    at = data.index(b"\xff\xc4")
    data[at + 5 : at + 21] = bytes([255] * 16)
    file.write_bytes(data)
    roi = f"{base.roi.longitude_deg},{base.roi.latitude_deg},60"
    words = ["ingest", str(base.path), "--roi", roi, "--out", str(tmp_path / "d"), "--json"]
    assert main([*words, "--verify-images"]) == 2
    assert json.loads(capsys.readouterr().out)["failures"][0]["problem"] == "cannot be decoded"
