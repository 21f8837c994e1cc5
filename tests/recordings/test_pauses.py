"""Images that are missing from a camera's sequence: counted by its pauses, and reported by the verbs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mirror.cli.main import main
from mirror.errors import RecordingError
from mirror.recordings.pauses import count_missing_images
from mirror.recordings.registry import open_recording
from mirror.recordings.summary import summarise
from tests.fuzz.bases import boreas, dgp, folder


@given(st.integers(9, 60), st.data())
def test_count_equals_the_number_of_removed_images(count: int, data: st.DataObject) -> None:
    removed = data.draw(st.sets(st.integers(1, count - 2), max_size=(count - 1) // 4))
    jitter = np.random.default_rng(count).integers(-9_000_000, 9_000_000, count)
    stamps = np.delete(np.arange(count) * 100_000_000 + jitter, sorted(removed))
    assert count_missing_images(stamps) == len(removed)


def test_few_or_repeated_stamps_have_no_rate() -> None:
    for stamps in ([], [5], [5, 5], [5, 5, 5, 9]):
        assert count_missing_images(np.array(stamps, np.int64)) == 0


def test_removed_images_are_counted_by_camera(tmp_path: Path) -> None:
    base = folder(tmp_path)
    images = sorted((base.path / "images" / "front_wide").iterdir())
    for number in (3, 4, 9):
        images[number].unlink()
    cameras = summarise(open_recording(base.path)).cameras
    assert {name: camera.missing for name, camera in cameras.items()} == {"front_wide": 3, "rear": 0}


def test_missing_image_that_the_recording_names_is_an_error(tmp_path: Path) -> None:
    base = dgp(tmp_path)
    image = sorted((base.path / "rgb" / "CAM").iterdir())[2]
    image.unlink()
    with pytest.raises(RecordingError, match="missing") as caught:
        summarise(open_recording(base.path))
    assert caught.value.file == str(image)


def test_the_verbs_report_missing_images(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = boreas(tmp_path)
    sorted((base.path / "camera").iterdir())[2].unlink()
    assert main(["info", str(base.path)]) == 0
    assert "4 png at 0.5 Hz, 1 missing in pauses" in capsys.readouterr().out
    (tmp_path / "rois.csv").write_text(
        f"scene_id,longitude_deg,latitude_deg,radius_m\ns,{base.roi.longitude_deg},{base.roi.latitude_deg},60\n"
    )
    arguments = ["ingest", str(base.path), "--rois", str(tmp_path / "rois.csv"), "--out"]
    assert main([*arguments, str(tmp_path / "d")]) == 0
    assert "missing: 1 image:" in capsys.readouterr().out
    assert main([*arguments, str(tmp_path / "e"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["images_missing"] == 1
