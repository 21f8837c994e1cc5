"""Tests the initialisation of a small dataset: its layers, their inputs, and interrupted runs."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from hybridworldsim.mvs.methods import make_estimator
from hybridworldsim.mvs.options import InitialisationOptions
from hybridworldsim.mvs.run import InitialisationReport, initialise
from mirror.dataset.index import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout, manifest_sha256
from mirror.dataset.lock import writer_lock
from mirror.dataset.splits import make_split
from mirror.errors import DatasetError, UsageError
from mirror.integrity.run import check
from mirror.protocols.document import load_protocol
from mirror.protocols.views import plan_views
from mirror.schema.documents import NovelTraversal
from mirror.schema.files import read_table
from mirror.schema.tables import IMAGES, MASKS
from mirror.weights.resolve import WeightsUnavailableError
from tests.interruption import interrupt_before, interrupting
from tests.killed_after_a_layer import require_resumable
from tests.mvs.level_road import CAMERAS, LevelRoad
from tests.other_bytes import give_other_bytes


@pytest.fixture(scope="module")
def initialised(written: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, InitialisationReport]:
    """The dataset with layers of the level road, which tests do not change, and the report of the run."""
    root = Path(shutil.copytree(written, tmp_path_factory.mktemp("initialised") / "dataset"))
    return root, initialise(mirror.open(root), "s", method="road", estimator=LevelRoad(), width_px=48)


@pytest.fixture
def layered(initialised: tuple[Path, InitialisationReport], tmp_path: Path) -> Path:
    """A copy with layers of the level road."""
    return Path(shutil.copytree(initialised[0], tmp_path / "layered"))


def files(root: Path) -> dict[str, str]:
    return {
        folder.parent.relative_to(root).as_posix(): manifest_sha256(folder.parent)
        for folder in sorted(root.glob("traversals/*/layers/*/*/manifest.json"))
    }


def test_layers_are_written_for_training_traversals_only(initialised: tuple[Path, InitialisationReport]) -> None:
    dataset, report = initialised
    opened = mirror.open(dataset)
    train = opened.where(split="s", role="train").traversals()
    assert report.layer == "road@s" and set(report.written) == set(train) and not report.kept
    assert report.images == len(train) * len(CAMERAS) * 5 and report.known_share > 0.25
    assert report.points["ground"] > 100
    after = mirror.open(dataset).where(split="s")
    own = {
        row["traversal_id"]: row["layers"] for row in after.table("traversals", ["traversal_id", "layers"]).to_pylist()
    }
    for traversal_id, layers in own.items():
        there = {"depth/road@s", "masks/road@s", "points/road@s"} if traversal_id in train else set()
        assert there == set(layers)
    points = after.where(role="train", split="s").points()
    assert np.abs(points.position_m[:, 2]).max() < 0.3 and set(points.traversal_id) <= set(train)
    image = after.where(traversal=train[0]).frames()[0].images["front_wide"]
    depth = image.depth()
    assert depth is not None and depth.lens.width_px == 48 and np.isfinite(depth.decode()).any()
    assert [mask.kind for mask in image.masks()] == ["sky"] and image.masks()[0].decode().shape == (64, 96)
    assert not (dataset / ".mvs" / "road@s").exists()
    groups = ("DEP", "PTS", "MSK", "TAB", "DS0", "IDX")
    findings = [finding for rule, finding in check(dataset).findings if rule.rule_id.startswith(groups)]
    assert not [finding for finding in findings if "layers" in finding.file]


def test_images_of_a_stationary_vehicle_are_not_matched(dataset: Path) -> None:
    report = initialise(
        mirror.open(dataset),
        "s",
        method="road",
        estimator=LevelRoad(),
        options=InitialisationOptions(width_px=48, standing_m=1e3),
    )
    assert report.images == 2 * len(CAMERAS)
    images = [image for frame in mirror.open(dataset).where(split="s").frames() for image in frame.images.values()]
    assert sum(image.depth() is not None for image in images) == report.images < len(images)


def test_complete_layers_are_kept_and_an_interrupted_run_continues(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        initialise(
            mirror.open(dataset), "s", method="road", estimator=interrupting(LevelRoad(), "estimate", 8), width_px=48
        )
    assert files(dataset) == {}
    estimator = LevelRoad()
    initialise(mirror.open(dataset), "s", method="road", estimator=estimator, width_px=48)
    assert estimator.calls == 20 - 7
    first = files(dataset)
    # The run succeeds although another run holds the lock.
    with writer_lock(mirror.open(dataset).layout, wait=False):
        report = initialise(mirror.open(dataset), "s", method="road", estimator=LevelRoad(), width_px=48)
    assert len(report.kept) == 2 and not report.written and report.images == 0 and files(dataset) == first
    other = initialise(mirror.open(dataset), "s", method="road", estimator=LevelRoad(), width_px=48, version="again")
    assert len(other.written) == 2
    tables = [
        (folder / "points.parquet").read_bytes() for folder in sorted(dataset.glob("traversals/*/layers/points/*"))
    ]
    assert len(tables) == 4


def test_points_missing_after_a_killed_run_are_written_identically(layered: Path) -> None:
    before = files(layered)
    last = sorted(layered.glob("traversals/*/layers/points/road@s/manifest.json"))[-1]
    last.unlink()
    build_index(layered)
    report = initialise(mirror.open(layered), "s", method="road", estimator=LevelRoad(), width_px=48)
    assert len(report.written) == 1 and files(layered) == before


def test_layers_from_other_inputs_are_refused(layered: Path) -> None:
    with pytest.raises(DatasetError, match="derived_from: options: "):
        initialise(mirror.open(layered), "s", method="road", estimator=LevelRoad(), width_px=32)
    make_split(layered, "other", NovelTraversal(train=1))
    with pytest.raises(DatasetError, match=r"derived_from: .*traversal:"):
        initialise(mirror.open(layered), "other", method="road", estimator=LevelRoad(), width_px=48, version="s")


def test_layers_from_other_masks_are_refused(layered: Path) -> None:
    opened = mirror.open(layered)
    image = opened.where(split="s", role="train").frames()[0].images["front_wide"]
    traversal = opened.where(split="s", role="train").traversals()[0]
    writer = LayerWriter(Layout(layered), traversal, "masks", "people", "1")
    png = bytes(cv2.imencode(".png", np.zeros((64, 96), np.uint8))[1])
    row = {"camera": "front_wide", "timestamp_ns": image.timestamp_ns, "kind": "dynamic", "source": "people",
           "source_version": "1", **writer.file("a.png", png)}  # fmt: skip
    writer.finish(MASKS, [row], {})
    build_index(layered)
    with pytest.raises(DatasetError, match=r"derived_from: .*masks/people@1:"):
        initialise(mirror.open(layered), "s", method="road", estimator=LevelRoad(), width_px=48)


def test_dataset_opens_after_an_interrupted_write(dataset: Path) -> None:
    with interrupt_before("layers/points/*"):
        initialise(mirror.open(dataset), "s", method="road", estimator=LevelRoad(), width_px=48)
    begun = files(dataset)
    assert begun and not any("points" in name for name in begun)
    estimator = LevelRoad()
    report = initialise(mirror.open(dataset), "s", method="road", estimator=estimator, width_px=48)
    assert len(report.written) == 2 and estimator.calls == 0 and files(dataset).items() > begun.items()


def test_plane_sweep_runs_on_noise_without_sky_masks(dataset: Path) -> None:
    report = initialise(mirror.open(dataset), "s", width_px=48, options=InitialisationOptions(sky=False))
    assert report.layer == "plane-sweep@s"
    layers = mirror.open(dataset).where(split="s", role="train").table("traversals", ["layers"]).column(0).to_pylist()
    assert all(set(own) == {"depth/plane-sweep@s", "points/plane-sweep@s"} for own in layers)


def test_unknown_methods_are_refused(dataset: Path) -> None:
    with pytest.raises(UsageError, match="no estimator"):
        initialise(mirror.open(dataset), "s", method="magic")


def test_sky_masks_do_not_count_as_masks_of_road_users(layered: Path) -> None:
    made = mirror.open(layered)
    assert set(made.table("masks", ["kind"]).column(0).to_pylist()) == {"sky"}
    with pytest.raises(DatasetError, match="no layer to mask road users with"):
        plan_views(made, load_protocol("static-reconstruction"), "s")


def test_learned_estimator_loads_its_weights(
    dataset: Path, real_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Runs the published PatchmatchNet; the layers' manifests name the weights."""
    weights = real_data / "weights" / "patchmatchnet"
    if not weights.is_dir():
        pytest.skip(f"no weights in {weights}")
    monkeypatch.setenv("MIRROR_WEIGHTS", str(tmp_path / "nowhere"))
    with pytest.raises(WeightsUnavailableError, match=r"params_000007\.ckpt"):
        initialise(mirror.open(dataset), "s", method="patchmatchnet", width_px=48)
    assert files(dataset) == {}
    monkeypatch.setenv("MIRROR_WEIGHTS", str(weights))
    report = initialise(mirror.open(dataset), "s", method="patchmatchnet", width_px=48)
    assert report.layer == "patchmatchnet@s" and report.images == 20 and len(report.written) == 2
    made = sorted(dataset.glob("traversals/*/layers/depth/patchmatchnet@s/manifest.json"))
    own = hashlib.sha256(repr(make_estimator("patchmatchnet")).encode()).hexdigest()
    assert [json.loads(path.read_text())["derived_from"]["estimator"] for path in made] == [own, own]


def test_depth_of_other_bytes_is_estimated_again(dataset: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        initialise(
            mirror.open(dataset), "s", method="road", estimator=interrupting(LevelRoad(), "estimate", 8), width_px=48
        )
    image = mirror.open(dataset).where(split="s", role="train").frames()[0].images["front_wide"]
    give_other_bytes(dataset, image)
    estimator = LevelRoad()
    initialise(mirror.open(dataset), "s", method="road", estimator=estimator, width_px=48)
    # Its own depth map, and those that it was a source of.
    assert 20 - 7 < estimator.calls <= 20
    assert not (dataset / ".mvs").exists() or not any((dataset / ".mvs").iterdir())


def test_depth_of_images_before_their_redaction_is_not_used(dataset: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        initialise(
            mirror.open(dataset), "s", method="road", estimator=interrupting(LevelRoad(), "estimate", 8), width_px=48
        )
    layout = Layout(dataset)
    for name in mirror.open(dataset).where(split="s", role="train").traversals():
        rows = read_table(layout.recorded(name) / "images.parquet", IMAGES).to_pylist()
        writer = LayerWriter(layout, name, "redaction", "deidentify", "1")
        grey = bytes(cv2.imencode(".jpg", np.full((64, 96, 3), 99, np.uint8))[1])
        redacted = [{**row, **writer.file(f"{row['camera']}/{row['timestamp_ns']}.jpg", grey)} for row in rows]
        writer.finish(IMAGES, [{**row, "privacy": "redacted"} for row in redacted], {})
    build_index(dataset)
    estimator = LevelRoad()
    initialise(mirror.open(dataset), "s", method="road", estimator=estimator, width_px=48)
    assert estimator.calls == 20


def test_depth_continues_after_a_kill(dataset: Path) -> None:
    require_resumable(dataset, ["depth", str(dataset), "--split", "s", "--method", "sparse"])
