"""NCore stores, read back by the package nvidia-ncore through the reader of recordings."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from mirror.dataset.dataset import Dataset
from mirror.export.run import export
from mirror.geometry import Poses, angle_between_deg, interpolate
from mirror.geometry.cameras import camera_from_row
from mirror.geometry.geodesy import TangentFrame
from mirror.geometry.poses import COLUMNS
from mirror.recordings.protocol import Recording
from mirror.recordings.registry import open_recording
from tests.builders.street import make_street

pytest.importorskip("ncore")


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> tuple[Dataset, dict[str, Recording], tuple[str, ...]]:
    folder = tmp_path_factory.mktemp("ncore")
    dataset = make_street(folder / "street")
    written = export(dataset, "ncore", folder / "out")
    files = sorted(path.name for path in (folder / "out").glob("*.itar"))
    names = {name: name.replace(".", "_") for name in dataset.traversals()}
    assert files == sorted(f"{name}.ncore4.zarr.itar" for name in names.values())
    found = {traversal: open_recording(folder / "out" / name) for traversal, name in names.items()}
    assert written.images == dataset.count("images") and written.boxes == 20 and written.masks > 0
    return mirror.open(folder / "street"), found, written.notes


def test_poses_come_back(stored: tuple[Dataset, dict[str, Recording], tuple[str, ...]]) -> None:
    dataset, found, _ = stored
    (scene,) = dataset.table("scenes").to_pylist()
    world = TangentFrame(scene["longitude_deg"], scene["latitude_deg"], scene["height_m"])
    for traversal, recording in found.items():
        stamps, poses = dataset.where(traversal=traversal).frames()[0].track
        track = recording.track()
        assert track.longitude_deg is not None and track.latitude_deg is not None and track.height_m is not None
        places = world.from_geodetic(track.longitude_deg, track.latitude_deg, track.height_m)
        exact = interpolate(stamps, poses, track.timestamp_ns)
        assert np.abs(places - exact.translation).max() < 1e-5
        for edge in (0, -1):
            assert abs(int(track.timestamp_ns[edge]) - int(stamps[edge])) < 1_000


def test_lenses_shutters_and_mountings_come_back(stored: tuple[Dataset, dict[str, Recording], tuple[str, ...]]) -> None:
    dataset, found, notes = stored
    for traversal, recording in found.items():
        rows = {row["camera"]: row for row in recording.calibrations().to_pylist()}
        frames = dataset.where(traversal=traversal).frames()
        for name, image in frames[0].images.items():
            lens, back = image.camera_model, camera_from_row(rows[name])
            x, y = np.meshgrid(np.linspace(0, lens.width_px, 25), np.linspace(0, lens.height_px, 17))
            uv = np.column_stack([x.ravel(), y.ravel()])
            rays = lens.unproject(uv)
            shown = np.isfinite(rays.direction).all(axis=1)
            off = np.linalg.norm(back.project(rays.direction[shown]).uv_px - uv[shown], axis=1)
            assert off.max() < 0.1, (name, off.max())
            mounting = Poses.from_columns({key: [rows[name][key]] for key in COLUMNS})
            assert np.abs(mounting.translation - image.calibration.ego_SE3_camera.translation).max() < 1e-6
            assert angle_between_deg(mounting.rotation, image.calibration.ego_SE3_camera.rotation).max() < 1e-5
            assert rows[name]["shutter_direction"] == image.calibration.row["shutter_direction"]
            assert any(note.startswith(f"camera {name}:") and "px" in note for note in notes)


def test_images_and_boxes_come_back(stored: tuple[Dataset, dict[str, Recording], tuple[str, ...]]) -> None:
    dataset, found, _ = stored
    for traversal, recording in found.items():
        frames = dataset.where(traversal=traversal).frames()
        streams = recording.images()
        for name, stream in streams.items():
            expected = [frame.images[name].read() for frame in frames if name in frame.images]
            assert [data for _, data in stream.read(range(len(expected)))] == expected
        table = recording.boxes()
        assert table is not None
        rows = {(row["timestamp_ns"] // 1_000, row["track_id"]): row for row in table.to_pylist()}
        seen = 0
        for frame in frames:
            boxes = frame.boxes()
            for number, track in enumerate(boxes.track_id):
                row = rows[boxes.timestamp_ns // 1_000, track]
                pose = Poses.from_columns({key: [row[key]] for key in COLUMNS})
                assert np.abs(pose.translation - boxes.pose.translation[number]).max() < 1e-5
                assert angle_between_deg(pose.rotation, boxes.pose.rotation[number][None]).max() < 1e-3
                assert row["category"] == boxes.category[number]
                seen += 1
        assert seen == 10


def test_masks_of_road_users_are_in_the_frames(
    stored: tuple[Dataset, dict[str, Recording], tuple[str, ...]], tmp_path: Path
) -> None:
    from ncore.data.v4 import CameraSensorComponent, SequenceComponentGroupsReader

    dataset, _, _ = stored
    export(dataset, "ncore", tmp_path / "out")
    shown = 0
    for path in sorted((tmp_path / "out").glob("*.itar")):
        reader = SequenceComponentGroupsReader([path], max_threads=1)
        cameras = reader.open_component_readers(CameraSensorComponent.Reader)
        for camera in cameras.values():
            for stamp in camera.frames_timestamps_us[:, 1].tolist():
                names = camera.get_frame_generic_data_names(stamp)
                if "valid_mask_png" in names:
                    png = np.asarray(camera.get_frame_generic_data(stamp, "valid_mask_png"), np.uint8)
                    mask = cv2.imdecode(png, cv2.IMREAD_GRAYSCALE)
                    assert mask is not None and set(np.unique(mask)) <= {0, 255} and (mask == 0).any()
                    shown += 1
    assert shown > 0
