"""The detector of plates of many countries: its weights, the regions that it covers, and what it finds."""

from __future__ import annotations

import hashlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.plates.backgrounds import Background
from benchmarks.plates.fonts import held_out_glyphs
from benchmarks.plates.held_out import EDGES_PX, draw_held_out
from benchmarks.plates.recall import PlateTally
from benchmarks.plates.regions import REGIONS
from mirror.cli.main import main
from mirror.errors import UsageError
from mirror.privacy.detectors.protocol import DetectorOptions
from mirror.privacy.detectors.recall import ANY, RegionRecall, SyntheticRecall, covered_regions
from mirror.privacy.detectors.registry import default_choices, find_detector, parse_choice, require_coverage
from mirror.privacy.detectors.world_plates import SHA256, SHIPPED, WORLD_PLATES, WorldPlates, read_recall
from mirror.privacy.release.review import ReviewSession
from mirror.privacy.run import deidentify
from mirror.weights.errors import WeightsUnavailableError
from tests.privacy.conftest import make_dataset, options

FULL = RegionRecall(plates=50, covered=50, near_plates=20, near_covered=20)


@pytest.fixture(scope="module")
def detector() -> WorldPlates:
    pytest.importorskip("onnxruntime")
    return WorldPlates(DetectorOptions())


def test_the_weights_are_those_that_are_pinned_and_whose_recall_is_published(tmp_path: Path) -> None:
    data = SHIPPED.read_bytes()
    assert hashlib.sha256(data).hexdigest() == SHA256 and len(data) <= 5_000_000
    recall = read_recall()
    assert recall.weights_sha256 == SHA256 and set(recall.regions) == set(REGIONS)
    assert SHA256 in SHIPPED.with_name("README.md").read_text()
    (tmp_path / "other.onnx").write_bytes(data[:-1] + b"x")
    for path in (tmp_path / "other.onnx", tmp_path / "none.onnx"):
        with pytest.raises(WeightsUnavailableError, match="world_plates"):
            WorldPlates(DetectorOptions(path))


def test_a_region_is_covered_only_with_enough_published_recall() -> None:
    few = RegionRecall(plates=20, covered=20, near_plates=10, near_covered=10)
    poor = RegionRecall(plates=100, covered=89, near_plates=40, near_covered=40)
    near = RegionRecall(plates=100, covered=98, near_plates=40, near_covered=37)
    recall = SyntheticRecall(weights_sha256="a", images=30, regions={"EU": FULL, "US": FULL})
    assert covered_regions(recall, "a") == {"EU", "US", ANY}
    assert covered_regions(recall, "b") == set()
    for one in (few, poor, near):
        mixed = recall.model_copy(update={"regions": {"EU": FULL, "US": one}})
        assert covered_regions(mixed, "a") == {"EU"}
    assert covered_regions(recall.model_copy(update={"regions": {}}), "a") == set()
    assert WORLD_PLATES.plate_regions == covered_regions(read_recall(), SHA256) >= {"EU", "US"}


def test_plates_of_a_region_that_nobody_measured_are_refused() -> None:
    chosen = [parse_choice("centerface"), parse_choice("world_plates")]
    assert require_coverage(chosen, "eu") == "EU"
    with pytest.raises(UsageError, match="ATLANTIS"):
        require_coverage(chosen, "ATLANTIS")
    with pytest.raises(UsageError, match="any"):
        require_coverage([parse_choice("centerface"), parse_choice("clp_det")], "any")
    for region in ("CN", "EU", None):
        names = [one.name for one in default_choices(region)]
        assert "world_plates" in names and ("clp_det" in names) == (region == "CN")
        assert {find_detector(name).kind for name in names} == {"face", "plate"}


def test_plates_of_all_widths_are_covered(detector: WorldPlates) -> None:
    rng = np.random.default_rng(3)
    street = cv2.resize(rng.integers(60, 190, (9, 16, 3)).astype(np.uint8), (1280, 720), interpolation=cv2.INTER_CUBIC)
    tally = PlateTally()
    for image in draw_held_out(3, [Background(street, np.zeros((0, 4)))], held_out_glyphs(), edges_px=EDGES_PX[1:]):
        tally.add(image, detector(image.image))
    assert tally.missed(0.0)[0] == 0 and len(tally.shares) >= 3


def test_a_plate_that_fills_most_of_a_large_image_is_found(detector: WorldPlates) -> None:
    image = next(iter(draw_held_out(1, [_grey()], held_out_glyphs(), edges_px=(420.0, 480.0))))
    large = cv2.resize(image.image, None, fx=2.5, fy=2.5, interpolation=cv2.INTER_CUBIC)
    tally, shown = PlateTally(), type(image)(0, large, 2.5 * image.corners, image.designs, image.light)
    tally.add(shown, detector(large))
    assert tally.missed(1000.0) == (0, len(image.corners))
    assert detector(np.zeros((1, 1, 3), np.uint8)) == []


def test_a_dataset_with_plates_from_anywhere_is_released_only_after_a_review(tmp_path: Path) -> None:
    make_dataset(tmp_path / "dataset")
    given = options("faces", "plates@ANY", plate_region="any")
    assert deidentify(tmp_path / "dataset", given).exit_code() == 0
    about = ("--name", "street", "--licence", "CC-BY-4.0", "--contact", "privacy@example.org")
    command = ["release", "build", str(tmp_path / "dataset"), "--out", str(tmp_path / "release"), *about]
    # A small sample does not do, though all of it is reviewed: there are 18 images.
    _review(tmp_path / "dataset", 5)
    assert main([*command, "--sample", "5"]) == 1 and not (tmp_path / "release").exists()
    _review(tmp_path / "dataset", 18)
    assert main(command) == 0


def _review(root: Path, sample: int) -> None:
    session = ReviewSession(root, "anna", sample)
    for record in session.sample:
        session.say(record.out_sha256, "ok")


def _grey() -> Background:
    return Background(np.full((720, 1280, 3), 120, np.uint8), np.zeros((0, 4)))
