"""The examples of docs/recordings/folder.md are valid, and each reader has a page."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.geometry.quaternions import heading_deg
from mirror.recordings.registry import load_readers, open_recording
from mirror.recordings.time import TIME_BASES
from tests.builders.small_folder import write_image
from tests.conftest import ROOT
from tests.recordings.videos import FRAMES, write_video

PAGES = ROOT / "docs" / "recordings"
TEXT = (PAGES / "folder.md").read_text()


@pytest.fixture
def example(tmp_path: Path) -> Path:
    document, calibrations = re.findall(r"```json\n(.*?)```", TEXT, re.DOTALL)
    poses = re.search(r"```\n(timestamp,.*?)```", TEXT, re.DOTALL)
    assert poses is not None
    path = tmp_path / "recording"
    (path / "calibrations").mkdir(parents=True)
    (path / "recording.json").write_text(document)
    (path / "calibrations" / "factory.json").write_text(calibrations)
    (path / "poses.csv").write_text(poses[1])
    write_image(path / "images" / "front_wide" / "1772359200000000000.jpg")
    (path / "masks").mkdir()
    cv2.imwrite(str(path / "masks" / "front_wide.png"), np.zeros((6, 8), np.uint8))
    (path / "videos").mkdir()
    shutil.move(write_video(tmp_path / "rear.mp4"), path / "videos" / "rear.mp4")
    return path


def test_the_example_is_a_recording(example: Path) -> None:
    recording = open_recording(example)
    assert recording.rig is not None
    assert [camera.name for camera in recording.rig.cameras] == ["front_wide", "rear"]
    track = recording.track()
    assert track.longitude_deg is not None and track.latitude_deg is not None and track.rotation is not None
    assert track.longitude_deg[0] == pytest.approx(13.4, abs=0.02)
    assert track.latitude_deg[0] == pytest.approx(52.5, abs=0.02)
    # Grid north lies 1.27 degrees west of true north there.
    assert heading_deg(track.rotation)[0] == pytest.approx(91.5 - 1.27, abs=0.02)
    assert str(np.datetime64(int(track.timestamp_ns[0]), "ns"))[:19] == "2026-03-01T10:00:00"
    assert recording.calibrations().num_rows == 1
    images = recording.images()
    assert images["front_wide"].exposure_start_ns[0] == images["rear"].exposure_start_ns[0] == track.timestamp_ns[0]
    assert len(images["rear"].exposure_start_ns) == FRAMES


def test_every_built_in_reader_and_time_base_is_described() -> None:
    ours = [name for name, reader in load_readers().items() if type(reader).__module__.startswith("mirror.")]
    contents = (ROOT / "docs" / "recordings.md").read_text()
    for name in ours:
        page = (PAGES / f"{name}.md").read_text()
        assert page.startswith(f"# `{name}`") and f"](recordings/{name}.md)" in contents, name
        assert "\n| | |\n" in page or "\n|---|" in page or name == "rosbag2", "a table of what is read"
    assert [name for name in TIME_BASES if f"`{name}`" not in TEXT] == []


def test_json_examples_are_valid() -> None:
    assert all(json.loads(block) for block in re.findall(r"```json\n(.*?)```", TEXT, re.DOTALL))
