"""`mirror align`: passes through a textured corridor with the errors of consumer GPS, and one of noise."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.cli.main import main
from mirror.dataset import open as open_dataset
from mirror.errors import ExitCode
from mirror.geometry import (
    Poses,
    angle_between_deg,
    interpolate,
    quaternion_exp,
    quaternion_from_heading_pitch_roll,
    quaternion_multiply,
)
from mirror.geometry.poses import to_pose_numbers
from mirror.localisation.alignment.layer import correct_track
from mirror.localisation.alignment.run import find_steady
from mirror.recordings.assembly.assemble import encode_poses
from mirror.recordings.calibration import to_calibration
from mirror.recordings.folder_lens import write_calibrations
from mirror.recordings.protocol import Track
from tests.calibration.corridor import LENS, NOMINAL, corridor

pytest.importorskip("pycolmap")

DAY_NS, STEP_NS = 86_400_000_000_000, 200_000_000
START_NS = 1_772_359_200_000_000_000
IMAGES, STEP_M = 9, 1.1
# Number of the day, metres to the left, bias of the recorded positions, and of the recorded heading in degrees.
PASSES = {"monday": (0, 0.0, (2.0, -1.5, 0.5), 2.0), "tuesday": (1, 1.0, (-2.0, 1.0, -1.0), -2.0)}


def way(left_m: float) -> Poses:
    yaw = np.radians(0.3) * np.arange(IMAGES)
    places = np.column_stack([STEP_M * np.arange(IMAGES), left_m + np.cumsum(STEP_M * np.sin(yaw)), np.zeros(IMAGES)])
    heading = 90.0 - np.degrees(yaw)
    return Poses(quaternion_from_heading_pitch_roll(heading, np.zeros(IMAGES), np.zeros(IMAGES)), places)


def write_pass(out: Path, name: str, day: int, poses: Poses, images: list[bytes]) -> None:
    stamps = START_NS + day * DAY_NS + STEP_NS * np.arange(IMAGES)
    (out / "images" / "front_wide").mkdir(parents=True)
    for stamp, data in zip(stamps.tolist(), images):
        (out / "images" / "front_wide" / f"{stamp}.png").write_bytes(data)
    x, y, z = poses.translation.T
    (out / "poses.csv").write_bytes(encode_poses(Track(stamps, x_m=x, y_m=y, height_m=z, rotation=poses.rotation)))
    write_calibrations(out, [to_calibration("front_wide", LENS, to_pose_numbers(NOMINAL), "exact")])
    document = {
        "format": "mirror-folder", "version": "1.0", "drive_id": name, "vehicle_id": "v", "vehicle_type": "car",
        "rig_id": "one", "time_base": "unix_ns", "frame": {"kind": "local", "name": "corridor"},
        "reference_camera": "front_wide", "cameras": {"front_wide": {}}, "light": "day",
    }  # fmt: skip
    (out / "recording.json").write_text(json.dumps(document))


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("align")
    for name, (day, left, bias, heading) in PASSES.items():
        poses = way(left)
        cameras = poses @ NOMINAL[np.zeros(IMAGES, np.int64)]
        images = [corridor(cameras[np.array([number])]) for number in range(IMAGES)]
        turn = np.repeat(quaternion_exp(np.array([[0.0, 0.0, np.radians(heading)]])), IMAGES, axis=0)
        wrong = Poses(quaternion_multiply(turn, poses.rotation), poses.translation + np.array(bias))
        write_pass(folder / "recordings" / name, name, day, wrong, images)
    rng = np.random.default_rng(0)
    smooth = [cv2.GaussianBlur(rng.normal(size=(300, 400)), (0, 0), 2.0) for _ in range(IMAGES)]
    fog = [cv2.imencode(".png", np.clip(128 + 400 * one, 0, 255).astype(np.uint8))[1].tobytes() for one in smooth]
    write_pass(folder / "recordings" / "fog", "fog", 2, way(0.5), fog)
    rois = {
        "type": "FeatureCollection",
        "features": [
            {"type": "Feature", "geometry": None,
             "properties": {"scene_id": "corridor", "frame": "corridor", "x_m": 10.0, "y_m": 1.0, "radius_m": 60.0}},
        ],
    }  # fmt: skip
    (folder / "rois.geojson").write_text(json.dumps(rois))
    words = ("--rois", str(folder / "rois.geojson"), "--min-duration-s", "1", "--min-path-m", "5")
    assert main(["ingest", str(folder / "recordings"), *words, "--out", str(folder / "dataset")]) == ExitCode.DONE
    return folder / "dataset"


def poses_of(dataset: Path, layer: str) -> dict[str, Poses]:
    opened = open_dataset(dataset).with_layers(poses=layer)
    found = {}
    for row in opened.table("traversals").to_pylist():
        frames = opened.where(traversal=row["traversal_id"]).frames()
        stamps = np.array([frame.timestamp_ns for frame in frames])
        found[row["drive_id"]] = interpolate(*frames[0].track, stamps)
    return found


def errors_between(found: dict[str, Poses]) -> tuple[float, float]:
    """Largest errors of Tuesday's poses relative to Monday's, in metres and degrees."""
    true = way(0.0).inverse() @ way(1.0)
    made = found["monday"].inverse() @ found["tuesday"]
    off = np.linalg.norm(made.translation - true.translation, axis=1)
    return float(off.max()), float(angle_between_deg(made.rotation, true.rotation).max())


def test_passes_come_together_and_the_one_that_shows_nothing_alike_is_named(
    dataset: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = errors_between(poses_of(dataset, "recorded"))
    assert before[0] > 4.0 and before[1] > 3.9
    capsys.readouterr()
    assert main(["align", str(dataset), "--step-m", "0.9", "--partners", "2", "--json"]) == ExitCode.PARTLY_DONE
    said = {one["traversal_id"].split(".")[1]: one for one in json.loads(capsys.readouterr().out)["passes"]}
    found = poses_of(dataset, "aligned@1")
    off, turned = errors_between(found)
    assert off < 0.1 and turned < 0.1
    assert said["fog"]["status"] == "kept" and "0 of" in said["fog"]["problem"]
    recorded = poses_of(dataset, "recorded")
    assert np.abs(found["fog"].translation - recorded["fog"].translation).max() < 1e-12
    for name, other in (("monday", "tuesday"), ("tuesday", "monday")):
        one = said[name]
        assert one["registered"] == one["images"] >= IMAGES - 1 and one["moved_m"] > 1.0
        assert max(count for key, count in one["matched_with"].items() if f".{other}." in key) > 60
        # The stated uncertainty is of the size of the error.
        assert 1e-4 < one["sigma_m"] < 0.1 and one["sigma_deg"] < 0.2
    # Heights follow the images too, and the passes' common middle stays where the positions have it.
    assert abs(found["monday"].translation[:, 2].mean() - found["tuesday"].translation[:, 2].mean()) < 0.05
    assert main(["check", str(dataset), "--json"]) == ExitCode.DONE
    capsys.readouterr()
    assert main(["align", str(dataset), "--step-m", "0.9", "--partners", "2", "--json"]) == ExitCode.DONE
    assert {one["status"] for one in json.loads(capsys.readouterr().out)["passes"]} == {"existing"}
    assert main(["align", str(dataset), "--step-m", "3"]) == ExitCode.COULD_NOT_RUN
    assert "--version NAME" in capsys.readouterr().err


def test_a_model_of_aligned_poses_renders_a_drive(dataset: Path, tmp_path: Path) -> None:
    pytest.importorskip("torch")
    shares = ("--method", "by-scene", "--train", "1", "--val", "0", "--test", "0")
    assert main(["split", str(dataset), "all", *shares]) == ExitCode.DONE
    model = tmp_path / "model"
    words = ("--split", "all", "--poses", "aligned@1", "--no-masks", "--width", "64", "--steps", "3", "--threads", "1")
    assert main(["reconstruct", str(dataset), *words, "--out", str(model)]) == ExitCode.DONE
    assert json.loads((model / "reconstruction.json").read_text())["poses"] == "aligned@1"
    drive = ("--trajectory", "lane-shift:0.5", "--width", "64", "--hz", "2", "--out", str(tmp_path / "drive"))
    assert main(["render", str(dataset), str(model), *drive]) == ExitCode.DONE
    assert any((tmp_path / "drive").rglob("*.png"))


def test_a_track_is_corrected_between_and_beyond_the_images() -> None:
    stamps = np.arange(0, 110, 10) * 1_000_000
    track = Poses(np.tile([1.0, 0.0, 0.0, 0.0], (11, 1)), np.column_stack([np.arange(11.0), np.zeros((11, 2))]))
    times = np.array([20, 45, 80]) * 1_000_000
    right = interpolate(stamps, track, times)
    found = Poses(right.rotation, right.translation + np.array([[0.0, 2.0, 0.0]]))
    both, poses = correct_track(stamps, track, times, found)
    assert both.tolist() == sorted({*stamps.tolist(), *times.tolist()})
    assert np.allclose(poses.translation[:, 1], 2.0) and np.allclose(poses.translation[:, 0], both / 10_000_000)
    # A wrong heading is corrected, and does not turn the way.
    turn = quaternion_exp(np.array([[0.0, 0.0, np.radians(2.0)]]))
    wrong = Poses(np.repeat(turn, 11, axis=0), track.translation)
    _, mended = correct_track(stamps, wrong, times, right)
    assert angle_between_deg(mended.rotation, np.tile([1.0, 0.0, 0.0, 0.0], (len(mended), 1))).max() < 1e-9
    assert np.abs(mended.translation[:, 1:]).max() < 1e-12


def test_images_in_a_wrong_place_are_found_at_the_end_of_a_pass_and_within_it() -> None:
    """Two images by night matched a wrong place 2 and 6.5 m away; the error of the heading moves all others slowly."""
    moved = np.column_stack([np.linspace(-2.0, -3.0, 30), np.linspace(-1.0, -2.2, 30), np.zeros(30)])
    moved[-2:, 0] -= (1.8, 6.1)
    moved[10, 1] += 3.0
    assert np.flatnonzero(~find_steady(moved)).tolist() == [10, 28, 29]
    assert find_steady(moved[:10]).all()
