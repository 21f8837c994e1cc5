"""DGP: the real scene, with a check of its projected boxes against labels; changed scenes for all errors."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mirror.arrays import Float64
from mirror.errors import RecordingError
from mirror.geometry.cameras.camera import Camera
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import rotate
from mirror.recordings.readers.dgp import DgpReader
from mirror.recordings.registry import open_recording
from mirror.schema.files import conform
from mirror.schema.tables import BOXES, CALIBRATIONS
from tests.recordings.clean_track import clean_track

CAMERAS = ("CAMERA_01", "CAMERA_05", "CAMERA_06", "CAMERA_07", "CAMERA_08", "CAMERA_09")
COLUMNS = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")


@pytest.fixture
def scene(real_data: Path) -> Path:
    return real_data / "dgp_scene_02"


@pytest.fixture
def copy(scene: Path, tmp_path: Path) -> Callable[[Callable[[dict[str, Any]], None]], Path]:
    """Return a function that copies the scene's JSON files and changes the scene file."""

    def altered(change: Callable[[dict[str, Any]], None]) -> Path:
        path = tmp_path / "scene"
        shutil.copytree(scene, path, ignore=lambda folder, names: {"rgb", "point_cloud"} & set(names))
        file = next(path.glob("scene_*.json"))
        document = json.loads(file.read_text())
        change(document)
        file.write_text(json.dumps(document))
        return path

    return altered


@pytest.mark.real_data
def test_real_scene_is_read(scene: Path) -> None:
    recording = open_recording(scene)
    assert recording.info.drive_id == recording.info.frame == "dgp_scene_02_fe9f29d3"
    assert recording.info.is_clip
    assert recording.rig is not None
    assert tuple(camera.name for camera in recording.rig.cameras) == CAMERAS
    assert recording.rig.reference_camera == "CAMERA_01"
    # Eight digits of a hash, as git abbreviates.
    calibration = next((scene / "calibration").iterdir()).stem
    assert recording.rig.rig_id == f"dgp_{calibration[:8]}"
    boxes = recording.boxes()
    assert boxes is not None
    ontologies = {file.stem[:8] for file in (scene / "ontology").iterdir()}
    assert set(boxes.column("source_version").to_pylist()) <= ontologies
    streams = recording.images()
    assert tuple(streams) == CAMERAS
    # The file names count units of 100 ns.
    for stream in streams.values():
        names = [int((stream.path(index) or Path()).stem) * 100 for index in range(3)]
        assert stream.exposure_start_ns.tolist() == stream.exposure_end_ns.tolist() == names
        assert next(iter(stream.read([2])))[1][:2] == b"\xff\xd8"
    conform(recording.calibrations(), CALIBRATIONS, file="calibrations")
    names = [name for name, _ in recording.files()]
    assert names == sorted(names)
    assert len(names) == 18 + 3 + 3
    assert not any(name.startswith("point_cloud") for name in names)


@pytest.mark.real_data
def test_vehicle_of_the_real_scene_drives_forward_and_level(scene: Path) -> None:
    track = open_recording(scene).track()
    assert track.x_m is not None and track.y_m is not None and track.rotation is not None
    assert len(track) == 6
    assert (np.diff(track.timestamp_ns) > 0).all()
    moved = np.array([track.x_m[-1] - track.x_m[0], track.y_m[-1] - track.y_m[0]])
    forward = rotate(track.rotation, (1.0, 0.0, 0.0))
    assert np.hypot(*moved) / ((track.timestamp_ns[-1] - track.timestamp_ns[0]) / 1e9) == pytest.approx(12.5, abs=0.5)
    assert (forward[:, :2] @ (moved / np.hypot(*moved)) > 0.999).all()
    assert (rotate(track.rotation, (0.0, 0.0, 1.0))[:, 2] > 0.99).all()


def _camera_SE3_boxes(recording: Any, stamp: int, calibration: dict[str, Any]) -> list[tuple[dict[str, Any], Poses]]:  # noqa: N802
    """Project the boxes of the sweep nearest to an image with the reader's track and calibration alone."""
    track = recording.track()
    world_SE3_ego = Poses(track.rotation, np.stack([track.x_m, track.y_m, track.height_m], axis=1))
    ego_SE3_camera = Poses.from_columns({name: [calibration[name]] for name in COLUMNS})
    rows = recording.boxes().to_pylist()
    sweep = min({row["timestamp_ns"] for row in rows}, key=lambda other: abs(other - stamp))
    at = interpolate(track.timestamp_ns, world_SE3_ego, [stamp, sweep])
    camera_SE3_ego = (at[0] @ ego_SE3_camera).inverse() @ at[1]
    chosen = [row for row in rows if row["timestamp_ns"] == sweep]
    return [(row, camera_SE3_ego @ Poses.from_columns({name: [row[name]] for name in COLUMNS})) for row in chosen]


def _hull(camera: Camera, camera_SE3_box: Poses, row: dict[str, Any]) -> Float64 | None:
    half = np.array([row["length_m"], row["width_m"], row["height_m"]]) / 2
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    seen = camera.project(camera_SE3_box.transform(corners)[0])
    if not seen.valid.all():
        return None
    raster = (camera.width_px, camera.height_px)
    return np.concatenate([np.clip(seen.uv_px.min(axis=0), 0, raster), np.clip(seen.uv_px.max(axis=0), 0, raster)])


@pytest.mark.real_data
def test_projected_boxes_agree_with_labels_in_the_images(scene: Path) -> None:
    """DGP also has each box in the frame of each camera, and 2D boxes by people: both are independent references."""
    recording = open_recording(scene)
    boxes = recording.boxes()
    assert boxes is not None
    conform(boxes, BOXES, file="boxes")
    assert boxes.num_rows == 39
    assert set(boxes.column("category").to_pylist()) <= {"Car", "Truck", "Person", "Bicycle", "Bus/RV/Caravan"}
    document = json.loads(next(scene.glob("scene_*.json")).read_text())
    images = {entry["datum"]["image"]["filename"]: entry for entry in document["data"] if "image" in entry["datum"]}
    off_m, overlaps = [], []
    for calibration in recording.calibrations().to_pylist():
        names = ("model", "width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px")
        camera = Camera(*(calibration[name] for name in names))
        stream = recording.images()[calibration["camera"]]
        for index in range(3):
            file = stream.path(index)
            assert file is not None
            annotations = images[file.relative_to(scene).as_posix()]["datum"]["image"]["annotations"]
            flat, solid = (
                {
                    str(a["instance_id"]): a["box"]
                    for a in json.loads((scene / annotations[kind]).read_text())["annotations"]
                }
                for kind in "01"
            )
            for row, pose in _camera_SE3_boxes(recording, int(stream.exposure_start_ns[index]), calibration):
                if row["track_id"] not in solid:
                    continue
                there = solid[row["track_id"]]["pose"]["translation"]
                off_m.append(np.linalg.norm(pose.translation[0] - [there["x"], there["y"], there["z"]]))
                hull = _hull(camera, pose, row)
                if hull is not None and row["track_id"] in flat:
                    box = flat[row["track_id"]]
                    overlaps.append(
                        _iou(hull, np.array([box["x"], box["y"], box["x"] + box["w"], box["y"] + box["h"]]))
                    )
    assert len(off_m) >= 30
    assert np.median(off_m) < 0.015
    assert max(off_m) < 0.06
    assert len(overlaps) >= 30
    assert np.median(overlaps) > 0.9
    assert min(overlaps) > 0.65


def _iou(a: Float64, b: Float64) -> float:
    inner = np.clip(np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]), 0, None).prod()
    return float(inner / ((a[2:] - a[:2]).prod() + (b[2:] - b[:2]).prod() - inner))


@pytest.mark.real_data
def test_stamps_before_2200_are_kept(copy: Callable[..., Path], scene: Path) -> None:
    """A stamp of this century is kept; a stamp of the year 2464 is divided by ten."""

    def change(document: dict[str, Any]) -> None:
        for entry in document["data"]:
            entry["id"]["timestamp"] = entry["id"]["timestamp"].replace("2464-11-12T01:04", "2019-06-27T14:30")

    track = open_recording(copy(change)).track()
    assert str(np.datetime64(int(track.timestamp_ns[0]), "ns")) == "2019-06-27T14:30:09.936530000"
    assert str(np.datetime64(int(open_recording(scene).track().timestamp_ns[0]), "ns")).startswith(
        "2019-06-27T14:30:24"
    )


@pytest.mark.real_data
def test_stamps_of_2200_are_kept(copy: Callable[..., Path]) -> None:
    def change(document: dict[str, Any]) -> None:
        for entry in document["data"]:
            entry["id"]["timestamp"] = entry["id"]["timestamp"].replace("2464-11-12T01:04", "2200-06-27T14:30")

    track = open_recording(copy(change)).track()
    assert str(np.datetime64(int(track.timestamp_ns[0]), "ns")) == "2200-06-27T14:30:09.936530000"


@pytest.mark.real_data
def test_omitted_coordinate_is_zero(copy: Callable[..., Path]) -> None:
    """Protocol buffers written as JSON leave zeros out."""

    def change(document: dict[str, Any]) -> None:
        for entry in document["data"]:
            pose = next(iter(entry["datum"].values()))["pose"]
            del pose["translation"]["z"], pose["rotation"]["qy"]

    def explicit(document: dict[str, Any]) -> None:
        for entry in document["data"]:
            pose = next(iter(entry["datum"].values()))["pose"]
            pose["translation"]["z"] = pose["rotation"]["qy"] = 0.0

    without = open_recording(copy(change)).track()
    assert without.file is not None
    shutil.rmtree(without.file.parent)
    stated = open_recording(copy(explicit)).track()
    for name in ("x_m", "y_m", "height_m", "rotation"):
        np.testing.assert_array_equal(getattr(without, name), getattr(stated, name))


@pytest.mark.real_data
def test_a_scene_without_point_clouds_has_no_boxes(copy: Callable[..., Path]) -> None:
    def change(document: dict[str, Any]) -> None:
        document["data"] = [entry for entry in document["data"] if "image" in entry["datum"]]

    recording = open_recording(copy(change))
    assert recording.boxes() is None
    assert len(recording.track()) == 3


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda d: d["data"][1]["datum"]["image"].update(filename="../../secret.jpg"), "leads out of the recording"),
        (lambda d: d["samples"][0].update(calibration_key="../secret"), "leads out of the recording"),
        (lambda d: d["samples"][0].update(calibration_key="gone"), "missing"),
        (lambda d: d.pop("samples"), "not a DGP scene"),
        (lambda d: d["data"][1]["id"].update(timestamp="noon"), "'noon' is not a date and time"),
        (lambda d: d["data"][1]["datum"]["image"]["pose"]["rotation"].update(qw=0, qx=0, qy=0, qz=0), "no rotation"),
        (lambda d: d["data"][1]["datum"]["image"]["pose"]["translation"].update(x=float("nan")), "not finite"),
        (lambda d: d.update(data=[]), "no images"),
        (lambda d: d["data"][1]["id"].update(name="CAMERA_77"), "no extrinsics of CAMERA_77"),
    ],
)
def test_broken_scenes_are_refused(
    copy: Callable[..., Path], change: Callable[[dict[str, Any]], None], problem: str
) -> None:
    recording = open_recording(copy(change))
    with pytest.raises(RecordingError, match=problem) as caught:
        recording.files()
        clean_track(recording)
        recording.images()
        recording.calibrations()
    assert caught.value.file is not None


@pytest.mark.real_data
@pytest.mark.parametrize(
    ("name", "change", "place", "problem"),
    [
        ("scene", lambda d: d.pop("data"), "data", "the key is missing"),
        (
            "scene",
            lambda d: d["samples"][0].pop("calibration_key"),
            "samples[0]",
            "the key 'calibration_key' is missing",
        ),
        ("scene", lambda d: d["data"][3].pop("id"), "data[3]", "the key 'id' is missing"),
        ("scene", lambda d: d["data"][1]["datum"]["image"].pop("height"), "data[1]", "the key 'height' is missing"),
        ("scene", lambda d: d["data"][1]["datum"]["image"].pop("pose"), "data[1]", "the key 'pose' is missing"),
        ("scene", lambda d: d["data"][0].update(key="gone"), "data[0]", "no sample names the datum 'gone'"),
        ("scene", lambda d: d["data"][1]["datum"]["image"].update(filename=7), "data[1]", "7 is not a text"),
        ("scene", lambda d: d["ontologies"].update({"1": 5}), "ontologies", "5 is not a text"),
        ("calibration", lambda d: d.pop("names"), "the whole document", "the key 'names' is missing"),
        ("calibration", lambda d: d["intrinsics"][1].update(fx=None), "intrinsics of", "NoneType"),
        ("calibration", lambda d: d["extrinsics"][1].pop("rotation"), "extrinsics of", "the key 'rotation' is missing"),
        ("ontology", lambda d: d.pop("items"), "items", "the key 'items' is missing"),
        (
            "bounding_box_3d/LIDAR",
            lambda d: d["annotations"][2].pop("box"),
            "annotations[2]",
            "the key 'box' is missing",
        ),
        ("bounding_box_3d/LIDAR", lambda d: d.pop("annotations"), "annotations", "the key 'annotations' is missing"),
    ],
)
def test_a_malformed_entry_is_named_with_its_place(
    copy: Callable[..., Path], name: str, change: Callable[[dict[str, Any]], Any], place: str, problem: str
) -> None:
    path = copy(lambda document: None)
    file = min(path.glob("scene_*.json") if name == "scene" else (path / name).iterdir())
    document = json.loads(file.read_text())
    change(document)
    file.write_text(json.dumps(document))
    with pytest.raises(RecordingError) as caught:
        recording = open_recording(path)
        recording.files()
        recording.track()
        recording.calibrations()
        recording.boxes()
    error = caught.value
    assert error.file == str(file)
    assert error.place is not None and error.place.startswith(place)
    assert problem in error.problem
    assert error.expected is not None and error.remedy is not None
    assert "Error" not in error.problem


@pytest.mark.real_data
def test_camera_models(copy: Callable[..., Path]) -> None:
    path = copy(lambda document: None)
    file = next((path / "calibration").iterdir())
    original = json.loads(file.read_text())

    def model(**intrinsics: float) -> dict[str, Any]:
        altered = json.loads(json.dumps(original))
        altered["intrinsics"][1].update(intrinsics)
        file.write_text(json.dumps(altered))
        return dict(open_recording(path).calibrations().to_pylist()[0])

    with pytest.raises(RecordingError, match="fx, fy > 0"):
        model(fx=0.0)
    assert (model()["model"], model()["distortion"]) == ("pinhole", [])
    assert model(k1=0.1, p2=0.02)["distortion"] == [0.1, 0.0, 0.0, 0.02, 0.0]
    assert model(k1=0.1, k5=0.3)["model"] == "rational"
    assert model(k1=0.1, k4=0.3, fisheye=1)["distortion"] == [0.1, 0.0, 0.0, 0.3]
    for unsupported in ({"skew": 1.0}, {"xi": 0.2, "alpha": 0.5}, {"k5": 0.1, "fisheye": 1}):
        with pytest.raises(RecordingError, match="not supported"):
            model(**unsupported)


def test_broken_or_ambiguous_scene_files_are_refused(tmp_path: Path) -> None:
    (tmp_path / "scene_1.json").write_text('{"data": [')
    with pytest.raises(RecordingError, match="not valid JSON"):
        _ = DgpReader().open(tmp_path, {}).info
    (tmp_path / "scene_2.json").write_text("{}")
    with pytest.raises(RecordingError, match="2 scene files"):
        DgpReader().open(tmp_path, {})
