"""Folders that are nearly those of a reader are named for what they are: parts of Waymo v2, Lyft, T4."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from mirror.cli.main import main
from mirror.errors import ExitCode, RecordingError
from mirror.recordings.discovery import find_recordings
from mirror.recordings.registry import open_recording
from tests.recordings.formats.every import street_drive
from tests.recordings.formats.nuscenes import CHANNELS, write_nuscenes
from tests.recordings.formats.waymo import write_waymo


def test_poses_of_waymo_alone_are_a_drive(tmp_path: Path) -> None:
    drive = street_drive().with_cameras(("front_wide",))
    root = write_waymo(tmp_path / "waymo", [drive])
    for component in list(root.iterdir()):
        if component.name != "vehicle_pose":
            shutil.rmtree(component)
    (path,) = find_recordings([root]).recordings
    recording = open_recording(path)
    assert recording.rig is None and recording.images() == {}
    assert recording.track().timestamp_ns.tolist() == drive.pose_ns.tolist()


@pytest.mark.parametrize("kept", ["camera_image", "lidar_box"])
def test_a_folder_of_waymo_without_poses_is_named(
    kept: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = write_waymo(tmp_path / "waymo", [street_drive().with_cameras(("front_wide",))])
    for component in list(root.iterdir()):
        if component.name != kept:
            shutil.rmtree(component)
    assert main(["info", str(root)]) == ExitCode.COULD_NOT_RUN
    printed = capsys.readouterr().err
    assert f"Waymo v2 with {kept}, but without the component vehicle_pose" in printed
    with pytest.raises(RecordingError, match="without the component vehicle_pose"):
        open_recording(root)


def _lyft(root: Path, folder: str) -> Path:
    """Tables of nuScenes as Lyft has them: other sensors and places, and stamps that are fractions of microseconds."""
    drive = street_drive()
    names = tuple(name for name in drive.cameras if name in CHANNELS)
    write_nuscenes(root, [drive.with_cameras(names)])
    (root / "v1.0-mini").rename(root / folder)
    (root / "samples").rename(root / "images")
    tables = root / folder
    sensors = json.loads((tables / "sensor.json").read_text())
    sensors.append({"token": "zoomed", "channel": "CAM_FRONT_ZOOMED", "modality": "camera"})
    (tables / "sensor.json").write_text(json.dumps(sensors))
    rows = json.loads((tables / "sample_data.json").read_text())
    for row in rows:
        row["timestamp"] += 0.4
    (tables / "sample_data.json").write_text(json.dumps(rows))
    return root


@pytest.mark.parametrize("folder", ["v1.01-train", "v1.02-train", "train_data", "data"])
def test_tables_of_lyft_are_named(folder: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = _lyft(tmp_path / "lyft", folder)
    for path in (root, root / folder):
        assert main(["info", str(path)]) == ExitCode.COULD_NOT_RUN
        assert "Lyft Level 5" in capsys.readouterr().err
    out = ["--roi", "0,0", "--out", str(tmp_path / "d")]
    assert main(["ingest", str(root), *out]) == ExitCode.COULD_NOT_RUN
    assert "Lyft Level 5" in capsys.readouterr().err


def test_tables_of_t4_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive = street_drive()
    root = write_nuscenes(tmp_path / "t4", [drive.with_cameras(("front_wide",))])
    (root / "v1.0-mini").rename(root / "annotation")
    assert main(["info", str(root)]) == ExitCode.COULD_NOT_RUN
    assert "T4 format" in capsys.readouterr().err
