"""Statistics of datasets with exact truth, their plots and their verb."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.index import build_index
from mirror.dataset.statistics import SceneRow, Statistics, compute_statistics
from mirror.view.plots import write_plots
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass

CAMERAS = ("front_wide", "front_left", "rear")


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scene a: 100 s at 5 m/s by day, 50 s at 12 m/s in a rainy night; scene b: 50 s at 12 m/s; scene c: nothing."""
    root = tmp_path_factory.mktemp("stats")
    builder = Builder(root, cameras=CAMERAS)
    builder.scene("a", city="Toronto", scene_type="urban")
    builder.scene("b", longitude_deg=-80.0)
    builder.scene("c", longitude_deg=-81.0, city="Nowhere")
    slow = Pass("a", EPOCH, frames=200, frame_ns=SECOND // 2, speed_mps=5.0, pose_ns=SECOND // 50)
    fast = Pass("a", EPOCH + 1000 * SECOND, frames=100, frame_ns=SECOND // 2, speed_mps=12.0, light="night",
                weather="rain")  # fmt: skip
    other = Pass("b", EPOCH + 2000 * SECOND, frames=100, frame_ns=SECOND // 2, speed_mps=12.0)
    builder.drive("d0", [slow], vehicle_id="v0", refused=2)
    builder.drive("d1", [fast, other], vehicle_id="v1")
    build_index(root)
    return root


@pytest.fixture(scope="module")
def found(root: Path) -> Statistics:
    return compute_statistics(mirror.open(root))


def test_the_row_of_the_table(found: Statistics) -> None:
    row = found.row
    assert row.multi_traversal
    assert row.scenes == 2
    assert row.area_km2 == pytest.approx(2 * np.pi * 0.04)
    assert row.area_per_scene_km2 == pytest.approx(np.pi * 0.04)
    assert row.cities == ("Toronto",)
    assert row.hours == pytest.approx(200 / 3600)
    assert row.cameras == 3
    assert (row.light, row.weather) == (("day", "night"), ("clear", "rain"))
    assert row.conditions == "Day/Night/Rain"


def test_counts(found: Statistics) -> None:
    assert (found.traversals, found.drives, found.vehicles) == (3, 2, 2)
    assert found.vehicle_types == {"van": 3}
    assert found.refused == {"min_duration": 2}
    assert found.images == 3 * 400
    assert found.frames == 400
    assert found.image_bytes == 1000 * found.images
    assert found.camera_hours == pytest.approx(3 * found.row.hours)
    assert [(one.scene_id, one.traversals, one.drives) for one in found.scenes] == [
        ("a", 2, 2),
        ("b", 1, 1),
        ("c", 0, 0),
    ]
    assert found.scenes[0].light == {"day": 1, "night": 1}
    assert [(one.light, one.weather, one.traversals) for one in found.conditions] == [
        ("day", "clear", 2), ("night", "rain", 1)]  # fmt: skip
    assert [one.hours * 3600 for one in found.conditions] == pytest.approx([150, 50])


def test_speeds_are_weighted_by_time(found: Statistics) -> None:
    speed = found.speed
    assert speed is not None
    # Half of the time at 5 m/s and half at 12 m/s, although the slow drive has far more poses.
    assert speed.mean_mps == pytest.approx(8.5, abs=1e-6)
    assert speed.quantiles_mps[25] == pytest.approx(5.0, abs=1e-6)
    assert speed.quantiles_mps[75] == pytest.approx(12.0, abs=1e-6)
    assert speed.standing == 0.0
    assert sum(speed.hours) == pytest.approx(found.row.hours)
    assert speed.hours[2] == pytest.approx(100 / 3600)


def test_a_view_has_its_own_statistics(root: Path) -> None:
    found = compute_statistics(mirror.open(root).where(light="night"))
    assert found.row.multi_traversal is False
    assert (found.traversals, found.images) == (1, 300)
    assert found.speed is not None
    assert found.speed.mean_mps == pytest.approx(12.0, abs=1e-6)


def test_an_empty_dataset(tmp_path: Path) -> None:
    root = tmp_path / "dataset"
    Builder(root).scene("a")
    build_index(root)
    found = compute_statistics(mirror.open(root))
    assert found.row.scenes == found.row.cameras == found.traversals == found.images == 0
    assert found.row.area_per_scene_km2 == 0.0
    assert found.row.conditions == "--"
    assert found.speed is None
    assert write_plots(found, tmp_path / "plots") == []
    assert main(["stats", str(root)]) == 0


def test_a_vehicle_that_stands(tmp_path: Path) -> None:
    root = tmp_path / "dataset"
    builder = Builder(root, cameras=())
    builder.scene("a")
    builder.drive("d", [Pass("a", frames=100, frame_ns=SECOND, speed_mps=0.0)])
    build_index(root)
    speed = compute_statistics(mirror.open(root)).speed
    assert speed is not None
    assert (speed.standing, speed.mean_mps) == (1.0, pytest.approx(0.0, abs=1e-9))
    assert write_plots(compute_statistics(mirror.open(root)), tmp_path / "plots")


def test_plots_are_images_of_the_figures(found: Statistics, tmp_path: Path) -> None:
    files = write_plots(found, tmp_path / "new" / "plots")
    assert [file.name for file in files] == ["traversals.png", "conditions.png", "speed.png"]
    for file in files:
        pixels = cv2.imread(str(file))
        assert min(pixels.shape[:2]) > 200
        assert pixels.std() > 5
    again = write_plots(found, tmp_path / "new" / "plots")
    assert again == files


def test_a_plot_of_many_scenes_stays_readable(found: Statistics, tmp_path: Path) -> None:
    scenes = [SceneRow(f"s{k:03}", None, None, k, 1, 0.1, 0, {"day": k}) for k in range(200)]
    (file, *_) = write_plots(replace(found, scenes=scenes), tmp_path)
    assert cv2.imread(str(file)).shape[0] < 2500


def test_the_verb(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stats", str(root), "--plots", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "Day/Night/Rain" in out
    assert str(tmp_path / "speed.png") in out
    assert main(["stats", str(root), "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert plain["row"]["scenes"] == 2
    assert plain["speed"]["mean_mps"] == pytest.approx(8.5)
    assert plain["plots"] == []


def test_plots_into_a_file_are_refused(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plots").write_text("")
    assert main(["stats", str(root), "--plots", str(tmp_path / "plots")]) == 2
    assert "cannot be written" in capsys.readouterr().err
