"""Rolling shutters of recordings: what a reader reads reaches calibrations, views of training, and drawn masks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mirror
from mirror.annotation.masks import MaskOptions, frame_masks
from mirror.dataset.image import Image
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.protocols.views.rolling import plan_shutter
from mirror.recordings.discovery import find_recordings
from mirror.recordings.registry import open_recording
from mirror.schema.documents import Roi
from tests.recordings.formats.kitti360 import write_kitti360
from tests.recordings.formats.street import StreetDrive, synth_drives
from tests.recordings.formats.waymo import READOUT_S, write_waymo
from tests.recordings.formats.waymo_drive import OFFSET_M, prepared


def ncore_drive(root: Path) -> tuple[Path, StreetDrive]:
    pytest.importorskip("ncore", reason="needs the extra ncore")
    from tests.recordings.formats.ncore import write_ncore

    drive = synth_drives()[0].with_cameras(("front_wide", "rear_left"))
    return write_ncore(root / "clips", [drive]), drive


def waymo_drive(root: Path) -> tuple[Path, StreetDrive]:
    drive = prepared(synth_drives()[0])
    return write_waymo(root / "training", [drive]), drive


def opened(source: Path, out: Path, centre_m: tuple[float, float]) -> mirror.Dataset:
    scene = Roi(scene_id="place", frame="town", x_m=centre_m[0], y_m=centre_m[1], radius_m=100.0)
    options = IngestOptions(workers=1, reader_options={"frame": "town"})
    report = ingest_recordings(find_recordings([source]).recordings, [scene], out, options)
    assert not report.failures and report.traversals
    return mirror.open(out)


def seen_at(image: Image, drive: StreetDrive, point_m: np.ndarray, velocity_mps: np.ndarray) -> np.ndarray | None:
    """The pixel of a moving point by bisection of the time of its line, with the true poses; None: it is not seen."""
    shutter, low, high = image.shutter, -0.6 * image.shutter.readout_ns, 0.6 * image.shutter.readout_ns
    mounting = drive.ego_SE3_camera[image.camera]
    uv = np.full(2, np.nan)
    for _ in range(40):
        offset_ns = 0.5 * (low + high)
        camera = drive.poses_at(np.array([image.timestamp_ns + round(offset_ns)])) @ mounting
        there = camera.inverse().transform((point_m + 1e-9 * offset_ns * velocity_mps)[None])[0]
        if there[0, 2] < 1.0:
            return None
        uv = image.camera_model.project(there).uv_px[0]
        if not np.isfinite(uv).all():
            return None
        low, high = (offset_ns, high) if shutter.offsets_ns(uv) > offset_ns else (low, offset_ns)
    return uv


@pytest.mark.parametrize(
    ("write", "direction", "readout_ns", "centre_m"),
    [
        (ncore_drive, "top_to_bottom", 16_000_000, (0.0, 0.0)),
        (waymo_drive, "left_to_right", round(READOUT_S * 1e9), OFFSET_M[:2]),
    ],
    ids=["ncore", "waymo"],
)
def test_a_recorded_shutter_reaches_views_and_masks(
    write: Callable[[Path], tuple[Path, StreetDrive]],
    direction: str,
    readout_ns: int,
    centre_m: tuple[float, float],
    tmp_path: Path,
) -> None:
    source, drive = write(tmp_path)
    dataset = opened(source, tmp_path / "dataset", centre_m)
    drawn, moved_px = 0, []
    frames = dataset.frames()
    for frame in list(frames)[4 : len(frames) - 4 : 6]:
        masks, boxes = frame_masks(frame, MaskOptions(margin=0.0)), frame.boxes("world")
        for name, image in frame.images.items():
            if name not in drive.cameras:
                continue
            assert image.shutter.direction == direction
            assert image.shutter.readout_ns == pytest.approx(readout_ns, abs=1_000)
            view = plan_shutter(image, image.camera_model)
            assert view is not None and view.direction == direction
            assert view.last_ns - view.first_ns == pytest.approx(readout_ns, rel=1e-3)
            for time_ns, pose in ((view.first_ns, view.world_SE3_first), (view.last_ns, view.world_SE3_last)):
                true = drive.poses_at(np.array([image.timestamp_ns + round(time_ns)])) @ drive.ego_SE3_camera[name]
                # poses between recorded ones are on a straight line
                assert np.abs((true.inverse() @ pose).log()).max() < 5e-3
            for near in ((0.9, 0.5, 2.0), (-0.9, -0.4, 2.5)):
                point = image.world_SE3_camera.transform(np.array([near]))[0, 0]
                uv = seen_at(image, drive, point, np.zeros(3))
                if uv is None:
                    continue
                np.testing.assert_allclose(image.project_moving(point[None], np.zeros(3))[0], uv, atol=0.02)
                moved_px.append(float(np.abs(uv - image.camera_model.project(np.array([near])).uv_px[0]).max()))
            speed = np.nan_to_num(boxes.velocity_mps)
            later_s = 1e-9 * (image.timestamp_ns - boxes.timestamp_ns)
            for row in range(len(boxes)):
                half = 0.5 * boxes.size_m[row] * np.array([1.0, 1.0, -1.0])
                corner = boxes.pose[row : row + 1].transform(half[None])[0, 0] + later_s * speed[row]
                uv = seen_at(image, drive, corner, speed[row])
                if uv is None or not ((uv > 1.0) & (uv < (image.width_px - 1, image.height_px - 1))).all():
                    continue
                column, line = np.floor(uv).astype(int)
                around = masks[name][max(line - 1, 0) : line + 2, max(column - 1, 0) : column + 2]
                assert around.any(), (name, row, uv)
                np.testing.assert_allclose(image.project_moving(corner[None], speed[row])[0], uv, atol=0.05)
                drawn += 1
    assert drawn >= 5 and max(moved_px) > 0.3


def test_kitti_360_records_no_readout(tmp_path: Path) -> None:
    """Its cameras are global: the reader states no readout, and training takes the path without one."""
    drive = synth_drives()[0].with_cameras(("front_wide",))
    drive = replace(drive, pose_ns=drive.image_ns["front_wide"])
    (path,) = find_recordings([write_kitti360(tmp_path / "KITTI-360", [drive])]).recordings
    rows = open_recording(path).calibrations().to_pylist()
    assert rows and {(row["shutter_direction"], row["readout_ns"]) for row in rows} == {("global", 0)}
