"""Lidar sweeps of recordings: names, stamps and poses; readers without them have none."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from mirror.errors import RecordingError
from mirror.geometry import Poses
from mirror.recordings.lidars import LidarSweeps, read_lidars
from mirror.recordings.missing_images import without_missing_images
from mirror.recordings.readers.nuscenes_lidars import ending_of_format, format_of_name
from mirror.recordings.registry import open_recording
from mirror.recordings.summary import summarise
from tests.recordings.formats.argoverse2 import write_argoverse2
from tests.recordings.formats.street import straight_drive


def test_sweeps_of_argoverse_lie_in_the_ego_frame(tmp_path: Path) -> None:
    drive = straight_drive()
    log = write_argoverse2(tmp_path, drive)
    recording = open_recording(log)
    (sweeps,) = read_lidars(recording)
    assert (sweeps.sensor, sweeps.format) == ("lidar", "av2_feather")
    assert sweeps.timestamp_ns.tolist() == drive.box_ns.tolist()
    assert sweeps.uris == tuple(str(log / "sensors" / "lidar" / f"{stamp}.feather") for stamp in drive.box_ns.tolist())
    assert np.abs(sweeps.ego_SE3_sensor.log()).max() == 0.0
    assert summarise(recording).sweeps == len(drive.box_ns)
    assert not any("lidar" in name for name, _ in recording.files())
    # What leaves missing images out keeps the sweeps.
    stream = recording.images()["front_wide"]
    Path(str(stream.path(0))).unlink()
    (left,) = read_lidars(without_missing_images(recording, 1.0))
    assert left.uris == sweeps.uris
    (log / "sensors" / "lidar" / "notes.txt").touch()
    with pytest.raises(RecordingError, match="no sweep of the lidars"):
        read_lidars(open_recording(log))
    shutil.rmtree(log / "sensors" / "lidar")
    assert read_lidars(open_recording(log)) == ()


def test_paths_are_absolute_also_of_a_recording_with_a_relative_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = write_argoverse2(tmp_path, straight_drive())
    monkeypatch.chdir(tmp_path)
    (sweeps,) = read_lidars(open_recording(Path(log.name)))
    assert all(Path(uri).is_absolute() and Path(uri).is_file() for uri in sweeps.uris)


def test_a_reader_without_sweeps_has_none() -> None:
    assert read_lidars(object()) == ()  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("count", "uri", "problem"), [(2, "/a", "1 stamps, 1 files and 2 poses"), (1, "a/b.bin", "is not absolute")]
)
def test_a_faulty_reader_is_named(count: int, uri: str, problem: str) -> None:
    with pytest.raises(RecordingError, match=problem):
        LidarSweeps("top", "dgp_npz", np.zeros(1, np.int64), (uri,), Poses.identity(count))


@pytest.mark.parametrize("form", ["nuscenes_pcd_bin", "kitti_velodyne_bin", "dgp_npz", "av2_feather"])
def test_a_name_states_its_format(form: str) -> None:
    assert format_of_name(f"samples/LIDAR/a.d0.17000__LIDAR__17{ending_of_format(form)}") == form


def test_the_name_of_another_file_states_its_ending() -> None:
    assert format_of_name("samples/LIDAR/a.d0.17000.bin") == "nuscenes_bin"
