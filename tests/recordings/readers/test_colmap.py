"""COLMAP: models that pycolmap writes are read back to their exact poses, cameras and stamps."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import mirror
from mirror.cli.main import main
from mirror.errors import ExitCode, RecordingError
from mirror.geometry.cameras import camera_from_row
from mirror.geometry.geodesy import TangentFrame
from mirror.geometry.poses import COLUMNS, Poses
from mirror.geometry.quaternions import quaternion_inverse, rotate
from mirror.ingest.request import IngestOptions
from mirror.ingest.rois import write_rois
from mirror.ingest.run import ingest_recordings
from mirror.integrity import Severity, check
from mirror.recordings.coordinates import FLU_FROM_CAMERA
from mirror.recordings.discovery import find_recordings
from mirror.recordings.protocol import Recording
from mirror.recordings.readers.colmap_lenses import to_lens
from mirror.recordings.readers.colmap_model import ColmapCamera
from mirror.recordings.registry import open_recording
from mirror.schema.documents import Roi
from tests.recordings.formats.compare import angle_between
from tests.recordings.formats.street import StreetDrive, straight_drive, synth_drives

pycolmap = pytest.importorskip("pycolmap", reason="the peer that writes the models is in the extra calibration")
from tests.recordings.formats.colmap import write_colmap  # noqa: E402

CAMERAS = ("front_wide", "front_left", "rear")


@pytest.fixture(scope="module")
def drives() -> tuple[StreetDrive, ...]:
    return tuple(drive.with_cameras(CAMERAS) for drive in synth_drives())


@pytest.fixture(scope="module")
def pristine(drives: tuple[StreetDrive, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_colmap(tmp_path_factory.mktemp("colmap") / "street", drives)


@pytest.fixture
def folder(pristine: Path, tmp_path: Path) -> Path:
    """A copy that a test may change: new files replace the links."""
    return Path(shutil.copytree(pristine, tmp_path / "street", copy_function=os.link))


def compare(recording: Recording, drive: StreetDrive, *, stagger: bool, pixel_px: float = 1e-6) -> None:
    """Every image has its exact pose, and projects points to the exact pixels; up to the ego frame, which is ours."""
    track = recording.track()
    assert track.x_m is not None and track.rotation is not None
    ego = Poses(track.rotation, np.stack([track.x_m, track.y_m, track.height_m], axis=1))
    reference = next(iter(drive.cameras))
    rows = {row["camera"]: row for row in recording.calibrations().to_pylist()}
    assert set(rows) == set(drive.cameras)
    assert recording.rig is not None and recording.rig.reference_camera == reference
    for name, stream in recording.images().items():
        stamps = drive.image_ns[name if stagger else reference]
        assert stream.exposure_start_ns.tolist() == stream.exposure_end_ns.tolist() == stamps.tolist()
        at = np.searchsorted(track.timestamp_ns, stamps)
        assert (track.timestamp_ns[at] == stamps).all()
        mounting = Poses.from_columns({column: [rows[name][column]] for column in COLUMNS})
        found = ego[at] @ mounting
        truth = drive.poses_at(stamps) @ drive.ego_SE3_camera[name]
        assert np.abs(found.translation - truth.translation).max() < 1e-7
        assert angle_between(found.rotation, truth.rotation).max() < 1e-8
        points = np.array([[0.1, -0.2, 1.0], [-0.3, 0.15, 1.0]])
        projected = camera_from_row(rows[name]).project(points).uv_px
        assert np.abs(projected - drive.cameras[name].project(points).uv_px).max() < pixel_px
        for index, data in stream.read([0, len(stamps) - 1]):
            assert data == drive.image(name, index)


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("rigs", [True, False])
def test_drives_are_read_back_exactly(text: bool, rigs: bool, drives: tuple[StreetDrive, ...], tmp_path: Path) -> None:
    """Rigs and frames of COLMAP 4, or every image on its own; binary and text (which has 17 digits)."""
    root = write_colmap(tmp_path / "street", drives, text=text, rigs=rigs)
    found = find_recordings([root])
    assert [path.name for path in found.recordings] == sorted(drive.name for drive in drives)
    for path in found.recordings:
        drive = next(drive for drive in drives if drive.name == path.name)
        recording = open_recording(path)
        assert (recording.info.drive_id, recording.info.frame) == (drive.name, "colmap_street")
        assert recording.info.has_date
        compare(recording, drive, stagger=not rigs)
        methods = recording.calibrations().column("method").to_pylist()
        assert "COLMAP PINHOLE; mounting: the reference camera" in methods
        # In a rig the cameras' relative poses are all equal; otherwise poses between images are interpolated.
        spreads = [float(method.rpartition("and ")[2].split()[0]) for method in methods if "spread" in method]
        assert len(spreads) == 2 and max(spreads) < (1e-9 if rigs else 0.05)
        assert recording.boxes() is None


def test_ingest_finds_the_traversals_of_both_drives(pristine: Path, tmp_path: Path) -> None:
    scene = Roi(scene_id="place", frame="colmap_street", x_m=0.0, y_m=0.0, radius_m=100.0)
    paths = find_recordings([pristine]).recordings
    report = ingest_recordings(paths, [scene], tmp_path / "d", IngestOptions(workers=1))
    assert not report.failures
    assert [one.images for one in report.traversals] == [3 * 52, 3 * 52]


def test_images_without_stamps_are_put_in_order(tmp_path: Path) -> None:
    """The images of a frame share their stamp; ``img10`` follows ``img9``."""
    drive = straight_drive()
    more = dict.fromkeys(drive.cameras, drive.pose_ns[:12])
    drive = StreetDrive(**{**vars(drive), "image_ns": more})
    root = write_colmap(tmp_path / "photos", [drive], names="numbers", folder="colmap")
    assert find_recordings([root]).recordings == (root,)
    recording = open_recording(root, options={"rate_hz": "2", "scale": "2.5", "frame": "my place"})
    info = recording.info
    assert (info.drive_id, info.frame, info.has_date) == ("photos", "my_place", False)
    track = recording.track()
    assert track.timestamp_ns.tolist() == [500_000_000 * number for number in range(12)]
    assert track.x_m is not None
    moved = np.diff(drive.poses_at(drive.pose_ns[:12]).translation[:, 0])
    np.testing.assert_allclose(np.diff(track.x_m), 2.5 * moved, atol=1e-7)
    assert recording.images()["rear"].exposure_start_ns.tolist() == track.timestamp_ns.tolist()


def test_frames_are_kept_together_whatever_their_names(tmp_path: Path) -> None:
    drive = straight_drive()
    root = write_colmap(tmp_path / "photos", [drive], names="numbers", text=True)
    file = root / "sparse/0/images.txt"
    file.write_text(file.read_text().replace("rear/img", "rear/zzz"))
    for image in (root / "images" / "rear").iterdir():
        image.rename(image.with_name(image.name.replace("img", "zzz")))
    streams = open_recording(root).images()
    assert streams["rear"].exposure_start_ns.tolist() == streams["front_wide"].exposure_start_ns.tolist()
    (root / "sparse/0/frames.txt").unlink()
    with pytest.raises(RecordingError, match="has the time of images of the reference camera"):
        open_recording(root).calibrations()


def test_an_origin_gives_degrees(tmp_path: Path) -> None:
    drive = straight_drive()
    root = write_colmap(tmp_path / "photos", [drive])
    recording = open_recording(root, options={"origin": "8.4,49.0,115.0"})
    assert recording.info.frame is None
    track = recording.track()
    assert track.longitude_deg is not None and track.latitude_deg is not None and track.height_m is not None
    place = TangentFrame(8.4, 49.0, 115.0).from_geodetic(track.longitude_deg, track.latitude_deg, track.height_m)
    camera = drive.poses_at(drive.image_ns["front_wide"]) @ drive.ego_SE3_camera["front_wide"]
    assert np.abs(place - camera.translation).max() < 1e-6


def test_a_collection_is_levelled_by_its_images(tmp_path: Path) -> None:
    drive = straight_drive().with_cameras(("front_wide",))
    root = write_colmap(tmp_path / "photos", [drive], text=True)
    model = pycolmap.Reconstruction(str(root / "sparse/0"))
    turn = pycolmap.Rotation3d(np.array([0.9, 0.3, -0.2]) / np.linalg.norm([0.9, 0.3, -0.2]) * 1.9)
    model.transform(pycolmap.Sim3d(1.0, turn, np.array([3.0, -2.0, 5.0])))
    model.write_text(str(root / "sparse/0"))
    tilted, level = (open_recording(root, options={"up": up}).track() for up in ("z", "images"))
    assert tilted.height_m is not None and level.height_m is not None and level.rotation is not None
    assert np.ptp(tilted.height_m) > 10.0 and np.ptp(level.height_m) < 1e-6
    assert rotate(level.rotation, (0.0, 0.0, 1.0))[:, 2].min() > 1.0 - 1e-9


def test_cameras_that_change_in_time_have_intervals(tmp_path: Path) -> None:
    """One folder with a camera for each image: one camera with a row for each of its images."""
    drive = straight_drive().with_cameras(("front_wide",))
    root = write_colmap(tmp_path / "photos", [drive], text=True)
    cameras, images = root / "sparse/0/cameras.txt", root / "sparse/0/images.txt"
    line = next(line for line in cameras.read_text().splitlines() if not line.startswith("#"))
    count = len(drive.image_ns["front_wide"])
    cameras.write_text("\n".join(f"{number + 1}{line[1:]}" for number in range(count)) + "\n")
    rows = [line for line in images.read_text().splitlines() if "front_wide/" in line]
    changed = [" ".join([*row.split()[:8], str(number + 1), row.split()[9]]) for number, row in enumerate(rows)]
    images.write_text("".join(f"{row}\n\n" for row in changed))
    (root / "sparse/0/frames.txt").unlink()
    (root / "sparse/0/rigs.txt").unlink()
    recording = open_recording(root)
    table = recording.calibrations().to_pylist()
    assert [row["camera"] for row in table] == ["front_wide"] * count
    assert [row["valid_from_ns"] for row in table] == drive.image_ns["front_wide"].tolist()
    assert len(recording.images()["front_wide"].exposure_start_ns) == count


@pytest.mark.parametrize(
    ("model", "parameters"),
    [
        ("SIMPLE_PINHOLE", [500.0, 320.0, 240.0]),
        ("PINHOLE", [500.0, 510.0, 320.0, 240.0]),
        ("SIMPLE_RADIAL", [500.0, 320.0, 240.0, -0.1]),
        ("RADIAL", [500.0, 320.0, 240.0, -0.1, 0.02]),
        ("OPENCV", [500.0, 510.0, 320.0, 240.0, -0.1, 0.02, 0.001, -0.002]),
        ("FULL_OPENCV", [500.0, 510.0, 320.0, 240.0, -0.1, 0.02, 0.001, -0.002, 0.003, 0.05, 0.01, 0.002]),
        ("SIMPLE_FISHEYE", [500.0, 320.0, 240.0]),
        ("FISHEYE", [500.0, 510.0, 320.0, 240.0]),
        ("SIMPLE_RADIAL_FISHEYE", [500.0, 320.0, 240.0, -0.03]),
        ("RADIAL_FISHEYE", [500.0, 320.0, 240.0, -0.03, 0.004]),
        ("OPENCV_FISHEYE", [500.0, 510.0, 320.0, 240.0, -0.03, 0.004, 0.001, -0.0005]),
    ],
)
def test_lenses_project_as_in_pycolmap(model: str, parameters: list[float]) -> None:
    theirs = pycolmap.Camera(model=model, width=640, height=480, params=parameters)
    lens = to_lens(ColmapCamera(model, 640, 480, tuple(parameters)), Path("cameras.bin"), "camera 1")
    ours = camera_from_row({"width_px": 640, "height_px": 480, **lens})
    points = np.random.default_rng(0).uniform((-0.5, -0.4, 1.0), (0.5, 0.4, 1.0), (200, 3))
    assert np.abs(ours.project(points).uv_px - theirs.img_from_cam(points)).max() < 1e-8


def test_other_lenses_are_refused_by_name() -> None:
    with pytest.raises(RecordingError, match="the camera model FOV is not supported") as caught:
        to_lens(ColmapCamera("FOV", 640, 480, (500.0, 500.0, 320.0, 240.0, 0.1)), Path("cameras.bin"), "camera 4")
    assert "image_undistorter" in str(caught.value.remedy) and caught.value.place == "camera 4"


@pytest.mark.real_data
def test_real_model_agrees_with_pycolmap(real_data: Path) -> None:
    recording = open_recording(real_data / "opensfm_lund")
    theirs = pycolmap.Reconstruction(str(real_data / "opensfm_lund" / "colmap"))
    track, stream = recording.track(), recording.images()["camera"]
    assert track.x_m is not None and track.rotation is not None
    by_name = {image.name: image for image in theirs.images.values()}
    assert len(track) == len(by_name) == 29
    for row in range(29):
        image = by_name[(stream.path(row) or Path()).name]
        centre = (track.x_m[row], track.y_m[row], track.height_m[row])  # type: ignore[index]
        assert np.abs(image.projection_center() - centre).max() < 1e-9
        camera = quaternion_inverse(FLU_FROM_CAMERA)
        found = rotate(track.rotation[row], rotate(quaternion_inverse(camera), (0.0, 0.0, 1.0)))
        assert np.abs(image.viewing_direction() - found).max() < 1e-9
    assert [Path(str(stream.path(row))).stem for row in range(29)] == [f"{number:02}" for number in range(1, 30)]


def _cut(data: bytes) -> bytes:
    return data[: len(data) // 2]


@pytest.mark.parametrize(
    ("name", "change", "problem"),
    [
        ("cameras", _cut, "ends in the middle of a record"),
        ("images", _cut, "ends in the middle of a record|without an end"),
        ("frames", _cut, "ends in the middle of a record"),
        ("images", lambda data: (2**60).to_bytes(8, "little") + data[8:], "ends in the middle of a record"),
        ("images", lambda data: data + b"\0", "bytes after the last record"),
        ("cameras", lambda data: data[:12] + (99).to_bytes(4, "little") + data[16:], "unknown camera model 99"),
        ("cameras", lambda data: data[:8] + (77).to_bytes(4, "little") + data[12:], "and the camera 1;"),
        ("images", lambda data: bytes(8), "no registered image"),
    ],
)
def test_damaged_models_are_named(folder: Path, name: str, change: Callable[[bytes], bytes], problem: str) -> None:
    file = folder / "sparse/0" / f"{name}.bin"
    data = file.read_bytes()
    file.unlink()
    file.write_bytes(change(data))
    with pytest.raises(RecordingError, match=problem) as caught:
        open_recording(folder / "guangzhou-urban-01")
    assert Path(str(caught.value.file)).name in (file.name, "images.bin") and caught.value.remedy is not None


def test_missing_images_links_and_pipes_are_refused(folder: Path, tmp_path: Path) -> None:
    image = next((folder / "images" / "guangzhou-urban-01" / "rear").iterdir())
    image.unlink()
    with pytest.raises(RecordingError, match="missing") as caught:
        open_recording(folder / "guangzhou-urban-01").files()
    assert caught.value.file == str(image)
    image.symlink_to(tmp_path / "elsewhere.jpg")
    with pytest.raises(RecordingError, match="leads out"):
        open_recording(folder / "guangzhou-urban-01").images()
    (folder / "sparse/0/cameras.bin").unlink()
    os.mkfifo(folder / "sparse/0/cameras.bin")
    with pytest.raises(RecordingError, match="no plain file"):
        open_recording(folder / "guangzhou-urban-01")


@pytest.mark.parametrize(
    "options",
    [{"origin": "1,2"}, {"origin": "1,200,3"}, {"rate_hz": "0"}, {"scale": "x"}, {"up": "y"}, {"stamps": "exif"}],
)
def test_options_are_checked(pristine: Path, options: dict[str, str]) -> None:
    with pytest.raises(RecordingError) as caught:
        open_recording(pristine / "guangzhou-urban-01", options=options)
    assert caught.value.place == f"option {next(iter(options))}"


def _without_points(root: Path) -> Path:
    """Rewrite ``images.txt`` with lines of poses alone, as some programs write it."""
    file = root / "sparse/0/images.txt"
    lines = [line for line in file.read_text().splitlines() if line.startswith("#") or ".jpg" in line]
    file.write_text("\n".join(lines) + "\n")
    return root


def test_images_without_lines_of_points_are_all_read(tmp_path: Path) -> None:
    drive = straight_drive()
    root = write_colmap(tmp_path / "photos", [drive], text=True)
    expected = open_recording(root)
    track, count = expected.track(), sum(len(stamps) for stamps in drive.image_ns.values())
    recording = open_recording(_without_points(root))
    assert sum(len(stream.exposure_start_ns) for stream in recording.images().values()) == count
    np.testing.assert_array_equal(recording.track().x_m, track.x_m)


def test_lines_of_points_are_told_from_images(tmp_path: Path) -> None:
    """With points, without, and a name that is made of words."""
    root = write_colmap(tmp_path / "photos", [straight_drive()], text=True)
    _without_points(root)
    file = root / "sparse/0/images.txt"
    poses = [line for line in file.read_text().splitlines() if ".jpg" in line]
    points = ["10.5 20.5 7 11.5 21.5 -1", "", "1e2 3.5 -1"]
    every = [line for pose, seen in zip(poses, [*points, *[""] * len(poses)]) for line in (pose, seen)]
    file.write_text("\n".join(every) + "\n")
    found = open_recording(root).model.images.name  # type: ignore[attr-defined]
    assert sorted(found) == sorted(pose.split()[9] for pose in poses)
    file.write_text("\n".join([*every[:3], "10.5 20.5", *every[4:]]) + "\n")
    with pytest.raises(RecordingError, match="neither points nor an image") as caught:
        open_recording(root)
    assert (caught.value.file, caught.value.place) == (str(file), "line 4")


def test_of_several_models_the_largest_is_read_and_all_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive = straight_drive().with_cameras(("front_wide",))
    small = StreetDrive(**{**vars(drive), "image_ns": {"front_wide": drive.image_ns["front_wide"][:2]}})
    root = write_colmap(tmp_path / "photos", [small])
    write_colmap(root, [drive], folder="sparse/1")
    write_colmap(root, [small], folder="sparse/10", text=True)
    recording = open_recording(root)
    assert len(recording.track()) == len(drive.image_ns["front_wide"])
    (note,) = recording.info.notes
    for folder, count in (("sparse/0", 2), ("sparse/1", len(drive.image_ns["front_wide"])), ("sparse/10", 2)):
        assert f"{folder} ({count} images)" in note
    assert "sparse/1 is read" in note and "--option model=" in note
    assert main(["info", str(root)]) == ExitCode.DONE
    assert note in capsys.readouterr().out.replace("\n", " ")
    assert len(open_recording(root, options={"model": "sparse/0"}).track()) == 2
    out = str(tmp_path / "d")
    roi = ["--rois", str(tmp_path / "rois.geojson"), "--out", out]
    write_rois(tmp_path / "rois.geojson", [Roi(scene_id="a", frame="colmap_photos", x_m=0, y_m=0, radius_m=90)])
    assert main(["ingest", str(root), *roi]) == ExitCode.DONE
    assert "sparse/1 is read" in capsys.readouterr().out


def test_unordered_photos_are_no_motion(tmp_path: Path) -> None:
    """Photos taken here and there, 50 m a second apart at the stated scale and rate, all keep their own poses."""
    rng = np.random.default_rng(1)
    drive = straight_drive().with_cameras(("front_wide",))
    place = np.stack([*rng.uniform(-9.0, 9.0, (2, 14)), np.full(14, 0.2)], axis=1)
    place[7] = place[6]
    turn = np.tile((1.0, 0.0, 0.0, 0.0), (14, 1))
    stamps = drive.pose_ns[0] + np.arange(14) * 1_000_000_000

    def poses_at(asked: np.ndarray) -> Poses:
        rows = (np.asarray(asked) - stamps[0]) // 1_000_000_000
        return Poses(turn[rows], place[rows])

    photos = StreetDrive(**{**vars(drive), "image_ns": {"front_wide": stamps}, "poses_at": poses_at})
    root = write_colmap(tmp_path / "photos", [photos], names="numbers")
    options = IngestOptions(workers=1, reader_options={"scale": "8", "rate_hz": "1"})
    scene = Roi(scene_id="place", frame="colmap_photos", x_m=0.0, y_m=0.0, radius_m=200.0)
    report = ingest_recordings([root], [scene], tmp_path / "d", options)
    assert not report.failures
    (one,) = report.drives.values()
    assert (one.cleaning.kept, one.cleaning.outliers, one.cleaning.repeated) == (14, 0, 0)
    assert [(written.images, written.without_pose) for written in report.traversals] == [(14, 0)]
    ego = open_recording(root, options=dict(options.reader_options)).track()
    frames = mirror.open(tmp_path / "d").frames()
    assert len(frames) == 14
    stored = np.array([frame.world_SE3_ego.translation[0] for frame in frames])
    np.testing.assert_allclose(stored[:, :2], np.stack([ego.x_m, ego.y_m], axis=1), atol=1e-6)  # type: ignore[list-item]
    found = [rule.rule_id for rule, _ in check(tmp_path / "d").findings if rule.severity is not Severity.INFO]
    assert found == ["CAM014"]
