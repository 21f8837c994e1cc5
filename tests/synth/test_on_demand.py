"""Tests of images on demand: a URI names an image, which is rendered when it is read."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import cv2
import fsspec
import numpy as np
import pytest

import mirror
import mirror.synth
from mirror.errors import DatasetError, UsageError
from mirror.ingest.rois import read_rois
from mirror.ingest.run import ingest_recordings
from mirror.integrity import check
from mirror.recordings.raster import TAIL_BYTES, has_end_marker, read_raster_size, require_complete_image
from mirror.synth.fleet import PRESETS
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.fleet.drives import make_drive
from mirror.synth.on_demand.png import TAIL, encode_stored_png, stored_png_length
from mirror.synth.on_demand.uri import ImageName, parse_image_name

NAME = ImageName("tiny", 0, "guangzhou-urban-02", "rear", 0)


def at(seconds: float, camera: str = "rear") -> str:
    start = make_drive("tiny", 0, NAME.drive_id).condition.start_ns
    return NAME._replace(true_ns=start + round(seconds * 1e9), camera=camera).uri()


@pytest.mark.parametrize(("width", "height"), [(1, 1), (7, 5), (160, 90), (21845, 1), (300, 220)])
def test_stored_png_length_matches_the_encoded_file(width: int, height: int) -> None:
    bgr = np.random.default_rng(width).integers(0, 256, (height, width, 3), np.uint8)
    data = encode_stored_png(bgr)
    assert len(data) == stored_png_length(width, height)
    assert data.endswith(TAIL) and len(TAIL) > TAIL_BYTES
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR), bgr)
    assert read_raster_size(data, "it") == (width, height)
    require_complete_image(data, "it")
    assert not has_end_marker(data[:-1], "png")


def test_uri_and_image_name_convert_both_ways() -> None:
    assert parse_image_name(at(6.0)) == parse_image_name(at(6.0).removeprefix("mirror-synth://"))
    assert parse_image_name(NAME.uri()) == NAME
    with pytest.raises(DatasetError, match="version 7") as caught:
        parse_image_name(NAME.uri().replace("//1/", "//7/"))
    assert caught.value.remedy is not None and "install" in caught.value.remedy
    for wrong in ("mirror-synth://1/tiny/0/a/rear", "mirror-synth://1/tiny/x/a/rear/5.png", "mirror-synth://", "x"):
        with pytest.raises(DatasetError, match="not the URI of an image"):
            parse_image_name(wrong)


def test_reading_renders_the_same_bytes_each_time() -> None:
    filesystem, path = fsspec.core.url_to_fs(at(6.0))
    with ThreadPoolExecutor(3) as pool:
        first, again, third = pool.map(filesystem.cat_file, [path] * 3)
    assert first == again == third
    drive = make_drive("tiny", 0, NAME.drive_id)
    expected = drive.render("rear", parse_image_name(path).true_ns).bgr
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(first, np.uint8), cv2.IMREAD_COLOR), expected)
    assert filesystem.cat_file(path, start=8, end=200) == first[8:200]
    assert filesystem.open(path).read() == first
    with pytest.raises(UsageError, match="read only"):
        filesystem.open(path, "wb")


def test_sizes_and_file_ends_need_no_rendering(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SynthDrive, "render", lambda *_: pytest.fail("rendered"))
    filesystem, path = fsspec.core.url_to_fs(at(7.0))
    size = filesystem.info(path)["size"]
    assert filesystem.exists(path)
    assert filesystem.cat_file(path, start=size - TAIL_BYTES, end=size) == TAIL[-TAIL_BYTES:]
    assert filesystem.cat_file(path, start=size, end=size + 5) == b""
    assert filesystem.ls(path, detail=False) == [path]


@pytest.mark.parametrize(
    "uri",
    [
        NAME._replace(drive_id="nowhere-01").uri(),
        NAME._replace(camera="roof").uri(),
        NAME._replace(preset="huge").uri(),
        at(9999.0),
    ],
)
def test_unknown_images_raise_file_not_found(uri: str) -> None:
    filesystem, path = fsspec.core.url_to_fs(uri)
    with pytest.raises(FileNotFoundError):
        filesystem.cat_file(path)


def test_recordings_refer_to_images_and_a_dataset_loads_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    referring = replace(PRESETS["tiny"], name="referring", on_demand=True)
    monkeypatch.setitem(PRESETS, "referring", referring)
    rendered: list[int] = []
    render = SynthDrive.render
    monkeypatch.setattr(SynthDrive, "render", lambda self, *words: (rendered.append(1), render(self, *words))[1])
    written = mirror.synth.write_recordings(tmp_path / "fleet", "referring", truth=("poses",))
    assert not list(tmp_path.rglob("*.jpg")) and not list(tmp_path.rglob("*.png"))[7:]
    assert written.images > 100 and written.boxes > 100
    report = ingest_recordings(written.recordings, read_rois(tmp_path / "fleet" / "rois.geojson"), tmp_path / "d")
    assert not report.failures
    found = check(tmp_path / "d")
    assert not [
        finding
        for rule, finding in found.findings
        if rule.rule_id.startswith("IMG") and rule.rule_id not in ("IMG009", "IMG013")
    ]
    unverified = [finding for rule, finding in found.findings if rule.rule_id == "IMG013"]
    assert unverified and sum(finding.count for finding in unverified) > 100
    assert not rendered
    dataset = mirror.open(tmp_path / "d")
    image = dataset.frames()[2].images["front_left"]
    pixels = image.decode(verify=True)
    assert image.uri.startswith("mirror-synth://1/referring/0/") and image.sha256 is None
    assert pixels.shape == (image.height_px, image.width_px, 3)
    drive = make_drive("referring", 0, parse_image_name(image.uri).drive_id)
    np.testing.assert_array_equal(
        pixels[:, :, ::-1], render(drive, "front_left", parse_image_name(image.uri).true_ns).bgr
    )
    assert len(rendered) == 1
