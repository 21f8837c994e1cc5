"""`mirror calibrate refine` on a small dataset: two cameras with a view in common, and one that sees nothing."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from mirror.calibration.refinement.report import RefinementReport
from mirror.calibration.refinement.run import DEFAULT_CHOICE, refine_calibrations
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.dataset.index import build_index
from mirror.errors import DatasetError, ExitCode
from mirror.geometry import Poses, matrix_from_quaternion
from tests.builders.dataset import Builder, Pass
from tests.calibration.corridor import LENS, NOMINAL, corridor, padded
from tests.interruption import InterruptingProgress, interrupt_before
from tests.other_bytes import give_other_bytes

CAMERAS = ("front_wide", "front_narrow", "rear")
ERRORS_DEG = {"front_wide": np.array([0.1, 0.3, -0.4]), "front_narrow": np.array([-0.3, -0.2, 0.5])}
CHOICE = replace(DEFAULT_CHOICE, frames=6)
BYTES = 400_000


def recorded_mounting(camera: str) -> Poses:
    return Poses(NOMINAL.rotation, NOMINAL.translation + np.array([[0.0, 0.1 * CAMERAS.index(camera), 0.0]]))


def true_mounting(camera: str) -> Poses:
    """The recorded mounting is turned by the error relative to the true one."""
    recorded = recorded_mounting(camera)
    error = Poses.exp(np.concatenate([np.radians(-ERRORS_DEG[camera]), np.zeros(3)])[None])
    return Poses((error @ Poses(recorded.rotation, np.zeros((1, 3)))).rotation, recorded.translation)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("refine") / "ds"
    builder = Builder(root, cameras=CAMERAS, lenses=dict.fromkeys(CAMERAS, LENS))
    builder.scene("a")
    images = dict.fromkeys(CAMERAS, b"x" * BYTES)
    passes = [
        Pass("a", frames=7, heading_deg=90.0, speed_mps=21.0, images=images, codec="png"),
        Pass("a", frames=7, heading_deg=90.0, speed_mps=21.0, offset_m=1.5, images=images, codec="png",
             entry_ns=Pass("a").entry_ns + 10**12),
        Pass("a", frames=4, entry_ns=Pass("a").entry_ns + 2 * 10**12, speed_mps=0.0, images=images, codec="png"),
    ]  # fmt: skip
    builder.drive("d", passes[:1])
    builder.drive("e", passes[1:], vehicle_id="v2")
    build_index(root)
    flat = padded(cv2.imencode(".png", np.full((300, 400, 3), 90, np.uint8))[1].tobytes(), BYTES)
    dataset = mirror.open(root)
    for name in dataset.traversals()[:2]:
        for frame in dataset.where(traversal=name).frames():
            for camera, image in frame.images.items():
                data = flat
                if camera in ERRORS_DEG:
                    ego = image.world_SE3_camera @ recorded_mounting(camera).inverse()
                    data = padded(corridor(ego @ true_mounting(camera)), BYTES)
                (root / image.uri).write_bytes(data)
    return root


@pytest.fixture(scope="module")
def refined(made: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, RefinementReport]:
    root = tmp_path_factory.mktemp("done") / "ds"
    shutil.copytree(made, root)
    return root, refine_calibrations(mirror.open(root), choice=CHOICE)


def files_of(root: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file() and "index" not in path.parts and path.suffix != ".jpg" and path.name != ".lock"
    }


def test_the_errors_between_the_cameras_are_removed(refined: tuple[Path, RefinementReport]) -> None:
    root, report = refined
    assert [item.status for item in report.traversals] == ["refined", "refined", "not refined"]
    assert "vehicle that moves" in (report.traversals[2].message or "")
    view = mirror.open(root).with_layers(calibrations="refined@1")
    true = [matrix_from_quaternion(true_mounting(name).rotation)[0] for name in CAMERAS[:2]]
    for name in view.traversals()[:2]:
        found = {
            camera: matrix_from_quaternion(image.calibration.ego_SE3_camera.rotation)[0]
            for camera, image in view.where(traversal=name).frames()[0].images.items()
        }
        cosine = 0.5 * (np.trace((true[0].T @ true[1]).T @ found["front_wide"].T @ found["front_narrow"]) - 1.0)
        assert np.degrees(np.arccos(min(cosine, 1.0))) < 0.03
    by_name = {one.camera: one for one in report.traversals[0].cameras}
    narrow = by_name["front_narrow"]
    assert narrow.status == "refined"
    assert narrow.reference == "front_wide"
    assert narrow.relative_deg == pytest.approx(
        np.linalg.norm(ERRORS_DEG["front_wide"] - ERRORS_DEG["front_narrow"]), abs=0.03
    )
    # Straight driving: pitch and yaw to the vehicle are found, the rig keeps the median roll of its two cameras.
    wide = by_name["front_wide"]
    assert wide.held == ("roll",)
    assert wide.vehicle_deg[0] == pytest.approx(-narrow.vehicle_deg[0], abs=2e-3)
    half = 0.5 * (ERRORS_DEG["front_wide"] - ERRORS_DEG["front_narrow"])[0]
    assert wide.vehicle_deg[0] == pytest.approx(half, abs=0.03)
    assert wide.vehicle_deg[1:] == pytest.approx(ERRORS_DEG["front_wide"][1:], abs=0.1)
    assert np.abs(wide.vehicle_deg[1:] - ERRORS_DEG["front_wide"][1:])[0] < 3.0 * wide.vehicle_sigma_deg[1]


def test_a_camera_without_features_keeps_its_calibration(refined: tuple[Path, RefinementReport]) -> None:
    root, report = refined
    rear = next(one for one in report.traversals[0].cameras if one.camera == "rear")
    assert rear.status == "kept"
    assert rear.observations == 0
    assert "too few features" in (rear.reason or "")
    assert report.exit_code() == ExitCode.PARTLY_DONE
    frame = mirror.open(root).with_layers(calibrations="refined@1").frames()[0]
    kept = frame.images["rear"].calibration
    assert kept.stage == "factory"
    assert (kept.ego_SE3_camera.translation == recorded_mounting("rear").translation).all()
    assert frame.images["front_wide"].calibration.stage == "refined"


def test_rows_have_covariances_and_provenance(refined: tuple[Path, RefinementReport]) -> None:
    root, _ = refined
    dataset = mirror.open(root)
    frame = dataset.with_layers(calibrations="refined@1").frames()[0]
    row = frame.images["front_narrow"].calibration.row
    covariance = np.array(row["covariance"]).reshape(6, 6)
    assert np.abs(covariance - covariance.T).max() < 1e-18
    assert np.linalg.eigvalsh(covariance)[0] > 0.0
    assert "rig adjustment" in row["method"]
    folder = dataset.layout.layer(frame.traversal_id, "calibrations", "refined", "1")
    derived = json.loads((folder / "manifest.json").read_text())["derived_from"]
    assert {f"traversal:{name}" for name in dataset.traversals()} <= set(derived)
    assert {"settings", "recorded"} <= set(derived)
    document = json.loads((folder / "refinement.json").read_text())
    assert document["cameras"][0]["camera"] == "front_narrow"
    shutter = document["cameras"][0]["shutter"]
    assert shutter["declared"] == "global" and shutter["problem"] is None
    assert shutter["readout_sigma_ms"] > 0.0
    assert main(["check", str(root), "--rule", "CAM"]) in (0, 1)


def test_recorded_files_do_not_change_and_layers_are_kept(made: Path, refined: tuple[Path, RefinementReport]) -> None:
    root, _ = refined
    before, after = files_of(made), files_of(root)
    assert {name: after[name] for name in before} == before
    again = refine_calibrations(mirror.open(root), choice=CHOICE)
    assert [item.status for item in again.traversals] == ["existing", "existing", "not refined"]
    assert files_of(root) == after
    with pytest.raises(DatasetError, match="other inputs"):
        refine_calibrations(mirror.open(root), choice=replace(DEFAULT_CHOICE, frames=5))


def test_the_verb_continues_an_interrupted_run_to_the_same_bytes(
    made: Path,
    refined: tuple[Path, RefinementReport],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    root = tmp_path / "ds"
    shutil.copytree(made, root)
    words = ["calibrate", "refine", str(root), "--frames", str(CHOICE.frames)]

    with interrupt_before("*.npz", 20):
        assert main(words) == 130
    found = {path: path.stat().st_mtime_ns for path in root.glob(".refine/*/*.npz")}
    assert 19 <= len(found) < 2 * 6 * 3
    with interrupt_before("*.npz", 10):
        assert main(words) == 130
    # The features of images are not found again.
    assert {path: path.stat().st_mtime_ns for path in found} == found
    capsys.readouterr()
    assert main(words) == 3
    text = capsys.readouterr().out
    assert "relative to front_wide" in text
    assert "roll unobservable" in text
    assert "layer: calibrations/refined@1" in text
    assert not (root / ".refine").exists()
    assert files_of(root) == files_of(refined[0])
    assert main([*words, "--json"]) == 3
    plain = json.loads(capsys.readouterr().out)
    assert [item["status"] for item in plain["traversals"]] == ["existing", "existing", "not refined"]
    assert main(["calibrate", "refine", str(root / "nothing")]) == 2


def test_an_unreadable_image_is_reported_and_left_out(made: Path, tmp_path: Path) -> None:
    root = tmp_path / "ds"
    shutil.copytree(made, root)
    view = mirror.open(root)
    view = view.where(traversal=view.traversals()[0])
    image = view.frames()[4].images["front_wide"]
    (root / image.uri).write_bytes(b"\0" * BYTES)
    report = refine_calibrations(view, choice=CHOICE)
    (item,) = report.traversals
    assert item.status == "refined"
    assert item.images == 3 * item.frames - 1
    assert str(image.timestamp_ns) in item.unread[0]
    assert report.exit_code() == ExitCode.PARTLY_DONE


def test_a_scene_without_matches_is_not_refined(made: Path, tmp_path: Path) -> None:
    root = tmp_path / "ds"
    shutil.copytree(made, root)
    view: Dataset = mirror.open(root)
    view = view.where(traversal=view.traversals()[0], camera="rear")
    report = refine_calibrations(view, choice=CHOICE)
    assert report.traversals[0].status == "not refined"
    assert "seen from two places" in (report.traversals[0].message or "")
    assert not list(root.glob("traversals/*/layers/calibrations/refined*"))


def test_features_of_other_bytes_are_found_again(made: Path, tmp_path: Path) -> None:
    root = tmp_path / "ds"
    shutil.copytree(made, root)

    def find_features() -> None:
        """End where matches follow."""
        with pytest.raises(KeyboardInterrupt):
            refine_calibrations(mirror.open(root), choice=CHOICE, progress=InterruptingProgress(0, phases=1))

    find_features()
    before = set(root.glob(".refine/*/*.npz"))
    give_other_bytes(root, mirror.open(root).frames()[3].images["front_wide"])
    find_features()
    assert len(set(root.glob(".refine/*/*.npz")) - before) == 1
