"""The steps of a de-identification in a dataset with poses, calibrations, boxes and masks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from mirror.dataset.index import build_index
from mirror.dataset.layout import Layout
from mirror.geometry.cameras import Camera
from mirror.privacy.geometry import propagate
from mirror.privacy.log import read_log
from mirror.privacy.options import Propagation, SkipRules
from mirror.privacy.regions import Region, region_at
from mirror.privacy.run import deidentify
from mirror.schema.files import write_bytes
from mirror.schema.tables import BOXES, MASKS
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass, box, mask_row
from tests.privacy.conftest import FACE, RED, marked, options
from tests.privacy.images import jpeg

FIRST, SECOND_CAMERA = "front_wide", "front_left"
OFF = Propagation(tracks=False, cameras=False, vehicles=False)


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Two cameras that look ahead at a car; rows without images."""
    root = tmp_path_factory.mktemp("street")
    lens = Camera("pinhole", 960, 540, 700.0, 700.0, 480.0, 270.0)
    builder = Builder(root, cameras=(FIRST, SECOND_CAMERA), lenses={FIRST: lens, SECOND_CAMERA: lens})
    builder.scene("a")
    (name,) = builder.drive("d", [Pass("a", EPOCH, frames=5, frame_ns=3 * SECOND)])
    build_index(root)
    stamps = sorted(set(mirror.open(str(root)).table("images", ["timestamp_ns"]).column(0).to_pylist()))
    builder.layer(name, "boxes", "petr@1", BOXES, [box(stamp, "car") for stamp in stamps])
    build_index(root)
    return root, name


def detections(root: Path) -> dict[tuple[str, int], list[Region]]:
    """A face in the first camera, which its detector misses in the third of five images."""
    found: dict[tuple[str, int], list[Region]] = {}
    for row in mirror.open(str(root)).table("images", ["camera", "timestamp_ns"]).to_pylist():
        found[row["camera"], row["timestamp_ns"]] = []
    for number, key in enumerate(sorted(key for key in found if key[0] == FIRST)):
        if number != 2:
            left = 600.0 + 2.0 * number
            found[key] = [region_at((left, 200.0, left + 30.0, 240.0), "face", score=0.9, source="d")]
    return found


@pytest.mark.parametrize("step", ["tracks", "cameras", "vehicles"])
def test_each_step_adds_regions_with_its_own_origin(street: tuple[Path, str], step: str) -> None:
    root, name = street
    dataset, detected = mirror.open(str(root)), detections(root)
    regions = propagate(dataset, name, detected, replace(OFF, **{step: True}), grow=0.3)
    added = {key: [one for one in found if one.origin != "detector"] for key, found in regions.items()}
    assert {one.origin for more in added.values() for one in more} == {step.removesuffix("s")}
    if step == "tracks":
        missed = sorted(key for key in added if key[0] == FIRST)[2]
        assert [key for key, more in added.items() if more] == [missed]
    elif step == "cameras":
        # The other camera sees the face at four instants of five.
        assert sorted((camera, len(more)) for (camera, _), more in added.items() if more) == [(SECOND_CAMERA, 1)] * 4
    else:
        # The car drives ahead: each image shows its rear.
        assert all(len(more) == 1 and more[0].kind == "plate" for more in added.values())


def test_no_step_adds_nothing(street: tuple[Path, str]) -> None:
    root, name = street
    detected = detections(root)
    assert propagate(mirror.open(str(root)), name, detected, OFF, grow=0.3) == detected


def test_skip_rules_are_counted_and_can_be_switched_off(tmp_path: Path, marks: None) -> None:
    root = tmp_path / "dataset"
    builder = Builder(root, cameras=("front_wide", "rear", "rear_left"), size=(128, 72))
    # A mask of the vehicle covers the first camera, one of the sky the second; a box is visible in the last frame only.
    full = cv2.imencode(".png", np.full((72, 128), 255, np.uint8))[1].tobytes()
    write_bytes(root / "rigs" / "ego.png", full)
    builder.write_rig({"front_wide": "ego.png"})
    builder.scene("a")
    images = {camera: jpeg(marked(1, (FACE, RED)), subsampling=0) for camera in builder.cameras}
    (name,) = builder.drive("d", [Pass("a", EPOCH, frames=2, frame_ns=6 * SECOND, images=images)])
    build_index(root)
    rows = mirror.open(str(root)).table("images", ["camera", "timestamp_ns"]).to_pylist()
    stamps = {camera: sorted(row["timestamp_ns"] for row in rows if row["camera"] == camera) for camera in images}
    folder = Layout(root).layer(name, "masks", "sam", "2")
    write_bytes(folder / "sky.png", full)
    uri = (folder / "sky.png").relative_to(root).as_posix()
    builder.layer(
        name, "masks", "sam@2", MASKS, [mask_row("rear", stamp, uri, full, kind="sky") for stamp in stamps["rear"]]
    )
    builder.layer(name, "boxes", "petr@1", BOXES, [box(stamps["front_wide"][1], "car")])

    # By default, rules that trust masks of the rig and the sky hold, and the one that trusts boxes does not.
    skipped = {}
    for version, rules in (("1", SkipRules()), ("2", SkipRules(ego=False, sky=False, without_boxes=True))):
        chosen = options("tiled", "plates", version=version, skip=rules, propagation=replace(OFF, repeats=0))
        report = deidentify(root, chosen)
        records = read_log(Layout(root).layer(name, "redaction", "deidentify", version) / "log.jsonl")
        skipped[version] = {(one.camera, one.timestamp_ns): (one.skipped, len(one.regions)) for one in records}
        assert sum(report.skipped.values()) == sum(sum(counts.values()) for counts, _ in skipped[version].values())
    for camera, two in stamps.items():
        searched = ({}, 1) if camera == "rear_left" else ({"tiles": 1}, 0)
        assert [skipped["1"][camera, stamp] for stamp in two] == [searched, searched]
        assert [skipped["2"][camera, stamp] for stamp in two] == [({"boxes": 1}, 0), ({}, 1)]
