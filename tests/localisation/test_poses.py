"""`mirror poses`: a drive through a textured corridor and exact geometry, against poses that are known exactly."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from mirror.calibration.refinement.features import ImageFeatures
from mirror.cli.main import main
from mirror.errors import ExitCode, UsageError
from mirror.geometry import Poses, angle_between_deg, quaternion_exp, quaternion_multiply
from mirror.geometry.poses import COLUMNS
from mirror.localisation.structure.maps import ImageMap
from mirror.localisation.structure.placing import keep_roll
from mirror.localisation.structure.rig_adjustment import adjust_rig
from mirror.localisation.structure.rig_scale import OtherCamera, scale_from_rig
from mirror.localisation.structure.road import mean_up, measure_road, mounting_rotation
from mirror.localisation.structure.road_sweep import sweep_road
from mirror.localisation.structure.similarity import fit_track
from mirror.localisation.structure.used_images import UsedImages
from mirror.recordings.lens_files import write_lens
from mirror.recordings.registry import open_recording
from tests.calibration.corridor import LENS, NOMINAL, corridor
from tests.localisation.phone_drive import IMAGES, START_NS, STEP_NS, drive, mounted

pytest.importorskip("pycolmap")


@pytest.fixture
def recording(images: Path, tmp_path: Path) -> Path:
    out = tmp_path / "phone"
    words = ("--camera", f"front={images}", "--drive-id", "monday", "--out", str(out))
    assert main(["recording", "new", *words]) == ExitCode.DONE
    return out


def posed(folder: Path) -> tuple[Poses, Poses]:
    """The ego's and the camera's poses of a recording."""
    made = open_recording(folder)
    track, (row,) = made.track(), made.calibrations().to_pylist()
    assert track.rotation is not None
    ego = Poses(track.rotation, np.column_stack([track.x_m, track.y_m, track.height_m]))
    return ego, ego @ Poses.from_columns({name: [row[name]] * len(ego) for name in COLUMNS})


def test_images_without_poses_become_a_recording_with_the_true_way(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Bars of the issue: 0.5 % of the path, 0.1 degrees, 95 % registered, 3 % of scale by the camera's height."""
    write_lens(tmp_path / "lens.yaml", LENS)
    out = tmp_path / "posed"
    words = ("--lens", str(tmp_path / "lens.yaml"), "--camera-height-m", "1.6", "--neighbours", "4")
    capsys.readouterr()
    assert main(["poses", str(recording), *words, "--out", str(out), "--json"]) == ExitCode.DONE
    (said,) = json.loads(capsys.readouterr().out)["recordings"]
    assert said["share"] >= 0.95 and said["used"] == IMAGES and len(said["parts"]) == 1
    assert said["parts"][0]["residual_px"] < 0.5
    ego, found = posed(out)
    truth = mounted(drive())
    way = np.linalg.norm(np.diff(truth.translation, axis=0), axis=1).sum()
    scale = np.linalg.norm(np.diff(found.translation, axis=0), axis=1).sum() / way
    assert abs(scale - 1.0) < 0.03
    # The rotations relative to the first one, and the places in the first camera's frame.
    first = np.zeros(IMAGES, np.int64)
    relative, expected = found[first].inverse() @ found, truth[first].inverse() @ truth
    assert np.median(angle_between_deg(relative.rotation, expected.rotation)) < 0.1
    off = np.linalg.norm(relative.translation / scale - expected.translation, axis=1)
    assert np.sqrt((off**2).mean()) < 0.005 * way
    # The vehicle's frame lies on the road below the camera, its z axis up.
    assert np.abs(ego.translation[:, 2]).max() < 0.05
    assert abs(found.translation[0, 2] - ego.translation[0, 2] - 1.6) < 0.02
    capsys.readouterr()
    assert main(["info", str(out), "--json"]) == ExitCode.DONE
    assert json.loads(capsys.readouterr().out)["poses"] == IMAGES


def test_nothing_is_guessed(recording: Path, images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["poses", str(recording), "--out", str(tmp_path / "a")]) == ExitCode.COULD_NOT_RUN
    assert "--camera-height-m METRES" in capsys.readouterr().err
    assert (
        main(["ingest", str(recording), "--roi", "0,0,200,x", "--out", str(tmp_path / "d")]) == ExitCode.COULD_NOT_RUN
    )
    assert "`mirror poses` finds those of a camera" in capsys.readouterr().err
    # Images that have nothing in common are refused, not placed.
    noise, rng = tmp_path / "noise", np.random.default_rng(0)
    noise.mkdir()
    for number in range(10):
        pixels = cv2.GaussianBlur(rng.integers(0, 255, (150, 200), np.uint8), (0, 0), 2.0)
        cv2.imwrite(
            str(noise / f"{START_NS + number * STEP_NS}.png"), cv2.normalize(pixels, None, 0, 255, cv2.NORM_MINMAX)
        )
    made = ("--camera", f"front={noise}", "--drive-id", "noise", "--out", str(tmp_path / "noise-recording"))
    assert main(["recording", "new", *made]) == ExitCode.DONE
    words = ("--length-m", "9", "--out", str(tmp_path / "b"))
    capsys.readouterr()
    assert main(["poses", str(tmp_path / "noise-recording"), *words]) == ExitCode.COULD_NOT_RUN
    assert "0 of 10 used images could be registered" in capsys.readouterr().err
    assert not (tmp_path / "b").exists()


def test_a_recording_without_a_track_needs_the_id_of_its_drive(
    images: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("--camera", f"front={images}", "--out", str(tmp_path / "x"))
    assert main(["recording", "new", *words]) == ExitCode.COULD_NOT_RUN
    assert "--drive-id" in capsys.readouterr().err


def test_the_height_of_the_camera_is_measured_on_the_road_and_not_on_kerbs_or_walls() -> None:
    rng = np.random.default_rng(2)
    ego = drive(60)
    cameras = mounted(ego)
    road = np.column_stack([rng.uniform(0, 25, 80), rng.uniform(-1, 1, 80), rng.normal(0, 0.01, 80)])
    kerb = np.column_stack([rng.uniform(0, 25, 300), np.full(300, -2.2), np.full(300, 0.15)])
    wall = np.column_stack([rng.uniform(0, 25, 900), np.full(900, 6.0), rng.uniform(0, 8, 900)])
    points = np.concatenate([road, kerb, wall]) / 3.7
    small = Poses(cameras.rotation, cameras.translation / 3.7)
    turn = mounting_rotation(small)
    found = measure_road(small, mean_up(small, turn), points)
    assert found is not None and abs(found.height * 3.7 / 1.6 - 1.0) < 0.01
    assert measure_road(small, mean_up(small, turn), points[80:]) is None


def test_a_map_is_laid_on_the_fixes_of_a_track_with_wild_ones_among_them() -> None:
    rng = np.random.default_rng(3)
    ego = drive(200)
    scale, turn = 0.21, quaternion_exp(np.array([[0.3, -0.2, 1.0]]))
    moved = Poses(turn, np.array([[4.0, 1.0, 2.0]]))[np.zeros(len(ego), np.int64)] @ Poses(
        ego.rotation, ego.translation * scale
    )
    fixes = ego.translation + rng.normal(0, 0.5, (200, 3))
    fixes[::25, :2] += 80.0
    up = mean_up(moved, np.eye(3))
    fit = fit_track(moved.translation, up, fixes, np.full(200, 0.5))
    assert abs(fit.similarity.scale * scale - 1.0) < 3 * fit.sigma_percent / 100 < 0.05
    off = np.linalg.norm(fit.similarity.move(moved.translation) - ego.translation, axis=1)
    assert np.median(off) < 0.5
    with pytest.raises(UsageError, match="--scale height"):
        fit_track(moved.translation[:4], up, fixes[:4], np.full(4, 0.5))
    # Without heights the vertical alone keeps the map level.
    fixes[:, 2] = np.nan
    level = fit_track(moved.translation, up, fixes, np.full(200, 0.5)).similarity.move(moved.translation)
    assert np.ptp(level[:, 2]) < 1.0


def test_the_scale_of_a_rig_survives_an_error_of_the_other_mounting() -> None:
    """Exact rays of a second camera 0.5 m to the right, whose recorded mounting is 0.2 degrees off."""
    rng = np.random.default_rng(4)
    ego = drive(12)
    cameras = mounted(ego)
    beside = Poses(NOMINAL.rotation, NOMINAL.translation - np.array([[0.0, 0.5, 0.0]]))
    world = np.column_stack([rng.uniform(8, 30, 400), rng.uniform(-5, 5, 400), rng.uniform(0, 6, 400)])
    names = rng.integers(0, 255, (400, 128)).astype(np.uint8)
    stamps = START_NS + STEP_NS * np.arange(12)

    def seen(poses: Poses) -> list[tuple[ImageFeatures, np.ndarray]]:
        shown = []
        for number in range(12):
            uv = LENS.project(poses[np.array([number])].inverse().transform(world)[0]).uv_px
            uv = uv + rng.normal(0, 0.1, uv.shape)
            own = np.flatnonzero(np.isfinite(uv).all(axis=1))
            shown.append((ImageFeatures(uv[own], np.ones(len(own)), names[own]), own))
        return shown

    first, second = seen(cameras), seen(ego @ beside[np.zeros(12, np.int64)])
    used = UsedImages("front", np.arange(12), stamps, [one for one, _ in first], 400, 300, 12)
    observed = [(own, np.arange(len(own))) for _, own in first]
    unit = 0.4
    small = Poses(cameras.rotation, cameras.translation * unit)
    found = ImageMap(np.arange(12), small, world * unit, observed, [LENS], 0.1, SimpleNamespace())
    error = Poses(quaternion_exp(np.radians([[0.05, 0.2, -0.1]])), np.zeros((1, 3)))
    other = OtherCamera("right", LENS, beside @ error, 0.3, stamps, [one for one, _ in second])
    rig = scale_from_rig(used, found, NOMINAL, [other])
    assert abs(rig.scale * unit - 1.0) < 0.01 and rig.sigma_percent < 1.0
    # All cameras together: a drift of the map's poses goes, and the map has metres.
    drift = np.cumsum(rng.normal(0, [0.002, 0.002, 0.002], (12, 3)), axis=0)
    bent = Poses(
        quaternion_multiply(quaternion_exp(drift - drift[:1]), small.rotation), small.translation + drift * unit
    )
    wrong = world * unit * (1.0 + rng.normal(0, 0.01, (400, 1)))
    start = ImageMap(np.arange(12), bent, wrong, observed, [LENS], 0.1, SimpleNamespace())
    whole = adjust_rig(used, start, rig.scale, rig.seen)
    origin = np.zeros(12, np.int64)
    before, after, truth = (one[origin].inverse() @ one for one in (bent, whole.world_SE3_camera, cameras))
    assert np.median(angle_between_deg(before.rotation, truth.rotation)) > 0.2
    assert np.median(angle_between_deg(after.rotation, truth.rotation)) < 0.02
    assert np.linalg.norm(after.translation - truth.translation, axis=1).max() < 0.05
    # Rays far from the axis have no place in an ideal camera.
    assert 0.9 < sum(len(one.points) for one in rig.seen) / sum(rig.rays.values()) <= 1.0
    far = ImageMap(np.arange(12), small, world * unit, [(own[:2], own[:2]) for own, _ in observed], [LENS], 0.1, None)
    with pytest.raises(UsageError, match="points of the map"):
        scale_from_rig(used, far, NOMINAL, [other])


def test_a_rider_in_a_mask_is_not_used(recording: Path, tmp_path: Path) -> None:
    """Features come from static pixels alone: a mask over everything leaves none."""
    masks = tmp_path / "masks" / "front"
    masks.mkdir(parents=True)
    for number in range(IMAGES):
        cv2.imwrite(str(masks / f"{START_NS + number * STEP_NS}.png"), np.full((300, 400), 255, np.uint8))
    words = ("--length-m", "6.5", "--masks", str(tmp_path / "masks"), "--out", str(tmp_path / "m"))
    assert main(["poses", str(recording), *words]) == ExitCode.COULD_NOT_RUN


def test_an_adjustment_to_a_straight_way_keeps_the_roll() -> None:
    ego = drive(40)
    straight = Poses(ego.rotation, ego.translation * (1.0, 0.02, 0.0))
    axis = np.linalg.svd(straight.translation - straight.translation.mean(axis=0))[2][0]
    turn = quaternion_exp((np.radians(9.0) * axis)[None])
    rolled = Poses(turn, np.zeros((1, 3)))[np.zeros(40, np.int64)] @ straight
    kept = keep_roll(straight, rolled)
    assert angle_between_deg(kept.rotation, straight.rotation).max() < 0.01
    off = kept.translation - rolled.translation
    assert np.linalg.norm(off - off.mean(axis=0), axis=1).max() < 0.1


@pytest.mark.parametrize("height_m", [1.6, 1.2])
def test_the_road_is_found_in_images_whose_map_has_no_point_of_it(height_m: float) -> None:
    ego = drive(14)
    lifted = Poses(NOMINAL.rotation, NOMINAL.translation + np.array([[0.0, 0.0, height_m - 1.6]]))
    cameras = ego @ lifted[np.zeros(14, np.int64)]
    unit, up = 0.3, np.array([0.0, 0.0, 1.0])
    small = Poses(cameras.rotation, cameras.translation * unit)

    def read(row: int) -> tuple[np.ndarray, np.ndarray]:
        data = np.frombuffer(corridor(cameras[np.array([row])]), np.uint8)
        return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)), np.ones((300, 400), np.bool_)

    found = sweep_road(small, up, LENS, read)
    assert found is not None and found.points >= 8
    assert abs(found.height / unit / height_m - 1.0) < 0.01
    assert found.sigma < 0.01 * found.height
    # Where the road is hidden, or the images show nothing alike, there is none.
    assert sweep_road(small, up, LENS, lambda row: (read(row)[0], np.zeros((300, 400), np.bool_))) is None
    rng = np.random.default_rng(5)
    noise = [rng.integers(0, 255, (300, 400), np.uint8) for _ in range(14)]
    assert sweep_road(small, up, LENS, lambda row: (noise[row], np.ones((300, 400), np.bool_))) is None
