"""The COLMAP export: pycolmap reads the cameras, poses, rigs and points that the dataset has."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.export.run import ExportOptions, export
from tests.builders.street import LENSES, make_street

pycolmap = pytest.importorskip("pycolmap")
MODELED = tuple(name for name, lens in LENSES.items() if lens.model != "f_theta")


def points_before(camera: str, seed: int) -> np.ndarray:
    """Points in a camera's frame that it images; COLMAP images none behind the plane of a fisheye."""
    lens = LENSES[camera]
    random = np.random.default_rng(seed)
    pixels = random.uniform((2.0, 2.0), (lens.width_px - 2.0, lens.height_px - 2.0), (64, 2))
    rays = lens.unproject(pixels)
    ahead = rays.direction[rays.valid & (rays.direction[:, 2] > 0.05)]
    return ahead * random.uniform(2.0, 80.0, (len(ahead), 1))


def largest_difference_px(dataset: Dataset, out: Path, origin_m: np.ndarray) -> float:
    """Of pixels that pycolmap computes from the export, from those of the dataset, over all images."""
    model = pycolmap.Reconstruction(str(out / "sparse" / "0"))
    by_name = {image.name: image for image in model.images.values()}
    worst, count = 0.0, 0
    for frame in dataset.frames():
        for camera, image in frame.images.items():
            in_camera = points_before(camera, count)
            world = image.world_SE3_camera.transform(in_camera)[0]
            expected = image.camera_model.project(in_camera).uv_px
            foreign = by_name[f"{frame.traversal_id}/{camera}/{image.timestamp_ns}.jpg"]
            found = np.array([foreign.project_point(point) for point in world - origin_m])
            worst, count = max(worst, float(np.abs(found - expected).max())), count + 1
    assert count == len(by_name) > 0
    return worst


def test_points_are_imaged_at_the_same_pixels(street: Dataset, tmp_path: Path) -> None:
    view = street.where(camera=MODELED)
    written = export(view, "colmap", tmp_path / "out")
    assert largest_difference_px(view, tmp_path / "out", np.zeros(3)) < 1e-6
    # 1 ms at 10 m/s is 1 cm: no camera has the pose that a rigid rig would give it.
    model = pycolmap.Reconstruction(str(tmp_path / "out" / "sparse" / "0"))
    assert model.num_rigs() == model.num_cameras() == 5
    assert model.num_frames() == model.num_images() == written.images == 50
    assert "each camera of 2 of 2 traversals is a rig of its own" in written.notes[0]


def test_rigs_of_cameras_that_are_exposed_together(tmp_path: Path) -> None:
    street = make_street(tmp_path / "dataset", MODELED, speed_mps=0.004)
    written = export(street, "colmap", tmp_path / "out")
    model = pycolmap.Reconstruction(str(tmp_path / "out" / "sparse" / "0"))
    # Both drives have the same calibration: one rig.
    assert (model.num_rigs(), model.num_cameras(), model.num_frames()) == (1, 5, 10)
    assert written.notes == ()
    (rig,) = model.rigs.values()
    assert rig.num_sensors() == 5
    # Cameras stand 0.1 m apart along the ego's y, which is the camera's -x.
    steps = [rig.sensor_from_rig(sensor).translation for sensor in sorted(rig.non_ref_sensors, key=lambda s: s.id)]
    np.testing.assert_allclose(steps, [[0.1 * step, 0.0, 0.0] for step in range(1, 5)], atol=1e-12)
    assert largest_difference_px(street, tmp_path / "out", np.zeros(3)) < 0.01
    assert model.is_valid()


def test_a_local_frame_is_moved_near_the_origin(tmp_path: Path) -> None:
    street = make_street(tmp_path / "dataset", MODELED[:2], frame="city")
    written = export(street, "colmap", tmp_path / "out")
    assert written.origin_m == (5000.0, 2000.0, 0.0)
    assert largest_difference_px(street, tmp_path / "out", np.array(written.origin_m)) < 1e-6
    model = pycolmap.Reconstruction(str(tmp_path / "out" / "sparse" / "0"))
    assert {tuple(point.xyz) for point in model.points3D.values()} >= {(-5000.0, -2000.0, 0.0)}


def test_points_of_a_split_are_those_of_training_traversals(street: Dataset, tmp_path: Path) -> None:
    view = street.where(camera=MODELED)
    export(view, "colmap", tmp_path / "all")
    written = export(view, "colmap", tmp_path / "split", ExportOptions(split="novel"))
    everything = pycolmap.Reconstruction(str(tmp_path / "all" / "sparse" / "0"))
    training = pycolmap.Reconstruction(str(tmp_path / "split" / "sparse" / "0"))
    assert (everything.num_points3D(), training.num_points3D(), written.points) == (14, 7, 7)
    points = sorted(training.points3D.values(), key=lambda point: point.xyz[0])
    np.testing.assert_array_equal([point.xyz for point in points], [[5.0 * r, -2.0 * r, 0.5 * r] for r in range(7)])
    np.testing.assert_array_equal([point.color for point in points], [[10 * r, 20, 30] for r in range(7)])
    names = (tmp_path / "split" / "splits" / "train.txt").read_text().split()
    assert len(names) == 25
    assert {image.name for image in training.images.values()} > set(names)


def test_masks_are_black_where_the_street_is_hidden(street: Dataset, tmp_path: Path) -> None:
    written = export(street.where(camera="front_wide"), "colmap", tmp_path / "out")
    assert written.masks == 1
    (mask,) = (tmp_path / "out" / "masks").rglob("*.png")
    pixels = cv2.imread(str(mask), cv2.IMREAD_UNCHANGED)
    assert not pixels[:20, :30].any()
    assert (np.delete(pixels, np.s_[:30], axis=1) == 255).all()
    assert (tmp_path / "out" / "images" / mask.relative_to(tmp_path / "out" / "masks").with_suffix("")).is_file()


def test_a_lens_without_a_model_is_refused_or_resampled(street: Dataset, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"colmap .*f_theta") as raised:
        export(street, "colmap", tmp_path / "out")
    assert "rear_left" in str(raised.value)
    assert "--undistort" in str(raised.value)
    assert not (tmp_path / "out").exists()
    written = export(street, "colmap", tmp_path / "out", ExportOptions(undistort=True))
    model = pycolmap.Reconstruction(str(tmp_path / "out" / "sparse" / "0"))
    assert {camera.model.name for camera in model.cameras.values()} == {"PINHOLE"}
    assert written.masks >= 10


def test_gsplat_has_no_rational_lens(street: Dataset, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"gsplat .*brown_conrady"):
        export(street.where(camera="front_left"), "gsplat", tmp_path / "out")
    export(street.where(camera=["front_wide", "front_narrow", "rear"]), "gsplat", tmp_path / "out")
    model = pycolmap.Reconstruction(str(tmp_path / "out" / "sparse" / "0"))
    assert {camera.model.name for camera in model.cameras.values()} == {"PINHOLE", "OPENCV", "OPENCV_FISHEYE"}


def test_the_verb(street: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["export", "colmap", street.root, "--camera", "front_wide", "--out", str(tmp_path / "out")]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "10 images, 1 masks, 14 points" in said
    assert "not in this format: boxes" in said
    assert main([*words[:-1], street.root]) == 2
