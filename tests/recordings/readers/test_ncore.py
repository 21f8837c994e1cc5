"""NCore V4: what the package's own writer wrote is read back to its exact poses, cameras, boxes and stamps."""

from __future__ import annotations

import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("ncore", reason="needs the extra ncore")

from mirror.errors import RecordingError
from mirror.geometry.cameras import camera_from_row
from mirror.geometry.geodesy import TangentFrame
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import quaternion_from_matrix, quaternion_multiply
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.recordings.discovery import find_recordings
from mirror.recordings.protocol import Track
from mirror.recordings.registry import open_recording
from mirror.schema.documents import Roi
from tests.recordings.formats.compare import Tolerances, compare_boxes, compare_cameras, compare_poses
from tests.recordings.formats.ncore import EXPOSURE_US, PLACE, VERSION, ecef_from_world, write_ncore
from tests.recordings.formats.street import StreetDrive, straight_drive, synth_drives

CAMERAS = {"front_wide": "front_wide", "rear_left": "rear_left"}
# Intrinsics are float32.
TOLERANCES = Tolerances(position_m=1e-5, angle_rad=1e-7, pixel_px=1e-4)


@pytest.fixture(scope="module")
def drives() -> tuple[StreetDrive, ...]:
    return tuple(drive.with_cameras(tuple(CAMERAS)) for drive in synth_drives())


@pytest.fixture(scope="module")
def pristine(drives: tuple[StreetDrive, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_ncore(tmp_path_factory.mktemp("ncore") / "clips", drives, world_global=ecef_from_world())


def in_world(track: Track) -> Poses:
    """The track of a sequence with a place, in the tangent frame of `PLACE`."""
    lon, lat, height = track.longitude_deg, track.latitude_deg, track.height_m
    assert lon is not None and lat is not None and height is not None and track.rotation is not None
    frame = TangentFrame(*PLACE)
    turn = quaternion_from_matrix(frame.world_R_enu(lon, lat))
    return Poses(quaternion_multiply(turn, track.rotation), frame.from_geodetic(lon, lat, height))


def in_local_frame(track: Track) -> Poses:
    assert track.x_m is not None and track.rotation is not None
    return Poses(track.rotation, np.stack([track.x_m, track.y_m, track.height_m], axis=1))


def test_sequences_are_read_back_exactly(pristine: Path, drives: tuple[StreetDrive, ...]) -> None:
    found = find_recordings([pristine])
    assert [path.name for path in found.recordings] == [drive.name for drive in drives]
    for path, drive in zip(found.recordings, drives):
        recording = open_recording(path)
        assert recording.info.drive_id == f"ncore_{drive.name}" and recording.info.frame is None
        track = recording.track()
        compare_poses(track.timestamp_ns, in_world(track), drive, TOLERANCES)
        compare_cameras(recording, drive, CAMERAS, TOLERANCES)
        velocities = compare_boxes(recording, drive, str, TOLERANCES)
        assert all(np.isnan(speed).all() for speed in velocities.values())
        boxes = recording.boxes()
        assert boxes is not None
        assert set(boxes.column("source").to_pylist()) == {"ncore_gt_synthetic"}
        assert set(boxes.column("source_version").to_pylist()) == {VERSION}
        rows = recording.calibrations().to_pylist()
        assert {(row["shutter_direction"], row["readout_ns"]) for row in rows} == {
            ("top_to_bottom", EXPOSURE_US * 1_000)
        }
        assert recording.rig is not None and recording.rig.reference_camera == "front_wide"
        mask = recording.rig.cameras[0].static_mask
        assert mask is not None and mask.shape == (36, 64) and mask[-3:].all() and not mask[:-3].any()
        assert [name for name, _ in recording.files()] == [f"{drive.name}.ncore4.zarr.itar"]


@pytest.mark.parametrize("box_frame", ["rig", "rear_left", "world"])
def test_stores_as_folders_in_groups_and_boxes_of_other_frames(
    drives: tuple[StreetDrive, ...], tmp_path: Path, box_frame: str
) -> None:
    # The frame of a box is one sample of the vehicle later than the box itself.
    folder = write_ncore(
        tmp_path / "n", drives[:1], store_type="directory", groups=True, box_frame=box_frame, late_us=50_000
    )
    recording = open_recording(folder)
    assert recording.info.frame == recording.info.drive_id
    track = recording.track()
    compare_poses(track.timestamp_ns, in_local_frame(track), drives[0], TOLERANCES)
    compare_cameras(recording, drives[0], CAMERAS, TOLERANCES)
    compare_boxes(recording, drives[0], str, TOLERANCES)
    names = [name for name, _ in recording.files()]
    assert sum(name.endswith(".zmetadata.cbor.xz") for name in names) == 3
    assert sum("/image/" in name for name in names) == 2 * 52


def test_a_global_frame_that_is_not_the_earths_is_local(drives: tuple[StreetDrive, ...], tmp_path: Path) -> None:
    moved = np.eye(4)
    moved[:3, 3] = (22_000.0, -4_300.0, 30.0)
    folder = write_ncore(tmp_path / "n", drives[:1], world_global=moved)
    recording = open_recording(folder, options={"frame": "town"})
    assert recording.info.frame == "town"
    track = recording.track()
    compare_poses(track.timestamp_ns, in_local_frame(track), drives[0].placed(tuple(moved[:3, 3])), TOLERANCES)


def test_ingest_finds_the_traversals_of_sequences_at_one_place(pristine: Path, tmp_path: Path) -> None:
    scene = Roi(scene_id="place", longitude_deg=PLACE[0], latitude_deg=PLACE[1], radius_m=100.0)
    report = ingest_recordings(
        find_recordings([pristine]).recordings, [scene], tmp_path / "d", IngestOptions(workers=1)
    )
    assert not report.failures
    assert [one.images for one in report.traversals] == [2 * 52, 2 * 52]


def test_chosen_cameras(pristine: Path, drives: tuple[StreetDrive, ...]) -> None:
    recording = open_recording(pristine / drives[0].name, options={"cameras": "rear_left"})
    assert list(recording.images()) == ["rear_left"] and recording.calibrations().num_rows == 1
    with pytest.raises(RecordingError, match="no images of the camera 'roof'"):
        _ = open_recording(pristine / drives[0].name, options={"cameras": "roof"}).rig


def lens_of(kind: str) -> Any:
    from ncore.data import (
        FThetaCameraModelParameters,
        OpenCVFisheyeCameraModelParameters,
        OpenCVPinholeCameraModelParameters,
        ShutterType,
    )

    raster = {"resolution": np.array([1920, 1080], np.uint64), "shutter_type": ShutterType.GLOBAL}
    centre = {"principal_point": np.array([955.25, 541.5], np.float32)}
    focal = {"focal_length": np.array([1010.5, 1012.25], np.float32)}
    if kind == "opencv-fisheye":
        radial = np.array([0.02, -0.004, 0.001, -0.0002], np.float32)
        return OpenCVFisheyeCameraModelParameters(**raster, **centre, **focal, radial_coeffs=radial, max_angle=1.2)
    if kind.startswith("opencv-pinhole"):
        radial = np.array([-0.3, 0.1, -0.02, *((0.01, -0.02, 0.003) if "rational" in kind else (0, 0, 0))], np.float32)
        prism = np.array([1e-3, 0, 0, 0] if "prism" in kind else [0, 0, 0, 0], np.float32)
        tangential = np.array([4e-4, -2e-4], np.float32)
        return OpenCVPinholeCameraModelParameters(
            **raster, **centre, **focal, radial_coeffs=radial, tangential_coeffs=tangential, thin_prism_coeffs=prism
        )
    forward = np.array([0.0, 930.0, 4.0, -60.0, 8.0, -1.5], np.float64)
    theta = np.linspace(0.0, 1.2, 400)
    radius = np.polynomial.polynomial.polyval(theta, forward)
    powers = radius[:, None] ** np.arange(1, 6)
    scale = np.abs(powers).max(axis=0)
    backward = np.concatenate([[0.0], np.linalg.lstsq(powers / scale, theta, rcond=None)[0] / scale])
    of_kind = FThetaCameraModelParameters.PolynomialType
    shear = np.array([1.0 + 4e-4, 3e-4, -2e-4] if "sheared" in kind else [1.0, 0.0, 0.0], np.float32)
    return FThetaCameraModelParameters(
        **raster,
        **centre,
        reference_poly=of_kind.PIXELDIST_TO_ANGLE if "backward" in kind else of_kind.ANGLE_TO_PIXELDIST,
        pixeldist_to_angle_poly=backward.astype(np.float32),
        angle_to_pixeldist_poly=forward.astype(np.float32),
        max_angle=1.2,
        linear_cde=shear,
    )


@pytest.mark.parametrize(
    ("kind", "model", "tolerance_px"),
    [
        ("opencv-pinhole", "brown_conrady", 1e-3),
        ("opencv-pinhole rational", "rational", 1e-3),
        ("opencv-fisheye", "kannala_brandt", 1e-3),
        ("ftheta", "f_theta", 1e-3),
        ("ftheta backward", "f_theta", 0.05),
        ("ftheta sheared", "f_theta", 0.4),
    ],
)
def test_lenses_image_points_where_ncore_does(tmp_path: Path, kind: str, model: str, tolerance_px: float) -> None:
    """The reference is the package's own camera model, in torch."""
    import torch
    from ncore.sensors import CameraModel

    lens = lens_of(kind)
    folder = write_ncore(
        tmp_path / "n", [straight_drive().with_cameras(("front_wide",))], lens=lambda drive, name: lens
    )
    (row,) = open_recording(folder).calibrations().to_pylist()
    assert row["model"] == model and row["readout_ns"] == 0
    x, y = np.meshgrid(np.linspace(-0.8, 0.8, 15), np.linspace(-0.45, 0.45, 9))
    points = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    reference = CameraModel.from_parameters(lens, device="cpu", dtype=torch.float64)
    expected = reference.camera_rays_to_image_points(torch.from_numpy(points), return_jacobians=False)
    valid = np.asarray(expected.valid_flag)
    found = camera_from_row(row).project(points).uv_px
    assert valid.sum() > 100
    distance = np.linalg.norm(found - np.asarray(expected.image_points), axis=1)[valid]
    assert distance.max() < tolerance_px
    if tolerance_px > 0.01:
        assert "as f_theta within" in row["method"]
        stated = float(row["method"].split("within ")[1].split(" px")[0])
        assert distance.max() < 1.5 * stated + 0.02


def test_lenses_without_a_counterpart_are_refused(tmp_path: Path) -> None:
    lens = lens_of("opencv-pinhole prism")
    folder = write_ncore(tmp_path / "n", [straight_drive()], lens=lambda drive, name: lens)
    with pytest.raises(RecordingError, match="thin prism") as caught:
        open_recording(folder).calibrations()
    assert caught.value.place == "camera front_wide" and "cameras=" in str(caught.value.remedy)


@pytest.fixture
def folder(pristine: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(pristine, tmp_path / "clips"))


def test_damaged_stores_are_named(folder: Path, drives: tuple[StreetDrive, ...], tmp_path: Path) -> None:
    file = folder / f"{drives[0].name}.ncore4.zarr.itar"
    data = file.read_bytes()
    for damaged in (b"", data[: len(data) // 2], data[:-512] + b"\0" * 512):
        file.write_bytes(damaged)
        with pytest.raises(RecordingError, match="cannot be read") as caught:
            open_recording(folder / drives[0].name).track()
        assert caught.value.file == str(file)
    file.unlink()
    (tmp_path / "outside").write_bytes(data)
    file.symlink_to(tmp_path / "outside")
    with pytest.raises(RecordingError, match="leads out"):
        open_recording(folder / drives[0].name).track()
    file.unlink()
    os.mkfifo(file)
    with pytest.raises(RecordingError, match="no plain file"):
        open_recording(folder / drives[0].name).track()
    with pytest.raises(RecordingError, match="no drive 'other'"):
        open_recording(folder / "other", "ncore")


def test_stores_of_two_sequences_are_not_mixed(tmp_path: Path) -> None:
    first, second = straight_drive(), replace(straight_drive(), name="second")
    folder = write_ncore(tmp_path / "n", [first])
    write_ncore(tmp_path / "m", [second])
    shutil.copy(tmp_path / "m" / "second.ncore4.zarr.itar", folder / "straight.ncore4-more.zarr.itar")
    with pytest.raises(RecordingError, match="belongs to sequence 'straight'") as caught:
        open_recording(folder).track()
    assert caught.value.file is not None and "straight.ncore4" in caught.value.file


def test_a_pose_that_is_no_rigid_motion_costs_its_row(tmp_path: Path) -> None:
    drive = straight_drive()
    folder = write_ncore(tmp_path / "n", [drive], tear_pose=7)
    track = open_recording(folder).track()
    assert track.bad is not None and track.bad.counts() == {"rotation": 1}
    assert track.bad.first.place == "pose 7 of rig in world" and len(track) == len(drive.pose_ns) - 1


def test_pickled_images_are_refused_and_nothing_is_executed(tmp_path: Path) -> None:
    """A store may name a codec that unpickles; the mark shows whether it did."""
    mark = tmp_path / "executed"
    folder = write_ncore(tmp_path / "n", [straight_drive()], store_type="directory", pickled_image=mark)
    recording = open_recording(folder)
    with pytest.raises(RecordingError, match="with a codec"):
        list(recording.images()["front_wide"].read([0]))
    assert not mark.exists()
    assert next(iter(recording.images()["rear"].read([0])))[1] == straight_drive().image("rear", 0)


def test_compressed_images_are_refused(tmp_path: Path) -> None:
    """Their size in memory is not the size of their bytes, which is checked before they are read."""
    folder = write_ncore(tmp_path / "n", [straight_drive()], store_type="directory", compressed_image=True)
    with pytest.raises(RecordingError, match="with a codec"):
        list(open_recording(folder).images()["front_wide"].read([0]))
