"""Frames whose images, and layers whose boxes, change under their names: what was made of them is not used again."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import mirror
from mirror.annotation import annotate
from mirror.annotation.descriptions import Description, describe_frames, read_descriptions
from mirror.annotation.masks import mask_layer
from mirror.annotation.tracking.layer import track_layer
from mirror.dataset.frames import Frame
from mirror.dataset.index.build import build_index
from mirror.dataset.layer_writer import LayerWriter, remove_layer
from mirror.dataset.layout import Layout, complete_manifest, seal
from mirror.errors import DatasetError
from mirror.schema.files import read_table
from mirror.schema.tables import BOXES, CALIBRATIONS
from tests.annotation.known import Known
from tests.builders.dataset import write_two_drives
from tests.interruption import interrupting
from tests.other_bytes import give_other_bytes


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A dataset whose images have detail, so that flat ones are shorter."""
    noise = np.random.default_rng(0).integers(0, 256, (32, 48, 3)).astype(np.uint8)
    return write_two_drives(tmp_path / "dataset", cv2.imencode(".jpg", noise)[1].tobytes())


class FrameList(Known):
    """Notes the frames that it is asked for."""

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[int] = []

    def annotate(self, frame: Frame):
        found = super().annotate(frame)
        self.asked.append(frame.timestamp_ns)
        return found


class Seeing:
    """Describes a frame by the brightness of its front image."""

    fingerprint = "seeing"

    def describe(self, frame: Frame) -> Description:
        return Description(str(round(float(np.median(frame.images["front_wide"].decode())))), None, None)

    def close(self) -> None:
        pass


def test_a_frame_with_other_images_is_annotated_again(root: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        annotate(mirror.open(root), interrupting(FrameList(), "annotate", 4))
    frames = list(mirror.open(root).frames())
    give_other_bytes(root, frames[1].images["rear"])
    second = FrameList()
    report = annotate(mirror.open(root), second)
    assert report.resumed == 2 and frames[1].timestamp_ns in second.asked and len(second.asked) == 5
    assert report.frames == 5 and not report.failed


def test_a_frame_with_another_calibration_is_annotated_again(root: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        annotate(mirror.open(root), interrupting(FrameList(), "annotate", 4))
    layout = Layout(root)
    name = mirror.open(root).traversals()[0]
    writer = LayerWriter(layout, name, "calibrations", "other", "1")
    writer.finish(CALIBRATIONS, read_table(layout.recorded(name) / "calibrations.parquet", CALIBRATIONS), {})
    build_index(root)
    assert annotate(mirror.open(root).where(traversal=name).with_layers(calibrations="other@1"), Known()).resumed == 0


def test_an_annotator_that_opens_no_image_reads_none(root: Path) -> None:
    class Blind(FrameList):
        reads_images = False

    with pytest.raises(KeyboardInterrupt):
        annotate(mirror.open(root), interrupting(Blind(), "annotate", 4))
    for frame in mirror.open(root).frames():
        (root / frame.images["rear"].uri).unlink()
    assert annotate(mirror.open(root), Blind()).resumed == 3


def test_a_frame_with_other_images_is_described_again(root: Path, tmp_path: Path) -> None:
    out = tmp_path / "descriptions"
    with pytest.raises(KeyboardInterrupt):
        describe_frames(mirror.open(root), interrupting(Seeing(), "describe", 4), out)
    frame = mirror.open(root).frames()[1]
    give_other_bytes(root, frame.images["front_wide"], 200)
    report = describe_frames(mirror.open(root), Seeing(), out)
    assert (report.kept, report.frames) == (2, 5)
    assert read_descriptions(out)[frame.traversal_id, frame.frame_index].text == "200"


@pytest.mark.parametrize("derive", [track_layer, mask_layer])
def test_tracks_and_masks_of_other_boxes_are_not_called_done(root: Path, derive) -> None:
    annotate(mirror.open(root), Known())
    derive(mirror.open(root), "known@1")
    assert len(derive(mirror.open(root), "known@1").kept) == 2
    # The boxes are removed and made again by hand, under the same name.
    name = mirror.open(root).traversals()[0]
    folder = Layout(root).layer(name, "boxes", "known", "1")
    rows = read_table(folder / "boxes.parquet", BOXES).slice(2)
    remove_layer(folder)
    writer = LayerWriter(Layout(root), name, "boxes", "known", "1")
    writer.finish(BOXES, rows.drop_columns(["source", "source_version"]), {})
    build_index(root)
    with pytest.raises(DatasetError, match=r"derived_from: known@1: .*same boxes") as refused:
        derive(mirror.open(root), "known@1")
    assert "--version" in str(refused.value)


def test_boxes_of_other_recorded_images_are_not_called_done(root: Path) -> None:
    annotate(mirror.open(root), Known())
    for name in mirror.open(root).traversals():
        folder = Layout(root).layer(name, "boxes", "known", "1")
        manifest = complete_manifest(folder)
        files = {file: (folder / file).read_bytes() for file in manifest.files}
        seal(folder, files, derived_from={**manifest.derived_from, "recorded": "0" * 64})
    build_index(root)
    with pytest.raises(DatasetError, match="derived_from: recorded: "):
        annotate(mirror.open(root), Known())


def test_a_journal_of_an_earlier_version_is_made_again(root: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        annotate(mirror.open(root), interrupting(Known(), "annotate", 4))
    (journal,) = root.glob(".annotate/*/*.jsonl")
    lines = [json.loads(line) for line in journal.read_text().splitlines()]
    journal.write_text("".join(json.dumps({"timestamp_ns": int(one["item"]), "boxes": []}) + "\n" for one in lines))
    report = annotate(mirror.open(root), Known())
    assert report.resumed == 0 and report.boxes == 14
