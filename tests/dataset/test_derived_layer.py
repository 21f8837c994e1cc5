"""A layer of stated inputs is missing, exists, or is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from mirror.dataset.derived_layer import DerivedLayer, find_missing
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout, complete_manifest, read_manifest, seal
from mirror.dataset.redaction import REDACTION
from mirror.dataset.unfinished_work import DEPTH, REFINEMENT, remove_work, work_folder
from mirror.errors import DatasetError
from mirror.schema.tables import IMAGES, POINTS
from tests.builders.dataset import Builder, Pass

HASH = "1" * 64


@pytest.fixture
def layers(tmp_path: Path) -> list[DerivedLayer]:
    builder = Builder(tmp_path / "dataset")
    builder.scene("a")
    names = [name for drive in ("d0", "d1") for name in builder.drive(drive, [Pass("a")])]
    inputs = {"options": HASH, "boxes": "2" * 64}
    return [DerivedLayer(builder.layout, name, "points", "made", "1", inputs, "the same options") for name in names]


def write(layer: DerivedLayer, **more: str) -> None:
    layer.open().finish(POINTS, [], more)


def change_record(folder: Path, **hashes: str | None) -> None:
    """Make a layer one of other inputs; None: without one."""
    manifest = complete_manifest(folder)
    assert manifest is not None
    derived = {name: value for name, value in {**manifest.derived_from, **hashes}.items() if value is not None}
    seal(folder, {name: (folder / name).read_bytes() for name in manifest.files}, derived_from=derived)


def test_layers_of_the_same_inputs_are_kept(layers: list[DerivedLayer]) -> None:
    first, second = layers
    write(first)
    assert find_missing(layers) == ([second.traversal_id], [first.traversal_id])
    manifest, recorded = read_manifest(first.folder), read_manifest(first.layout.recorded(first.traversal_id))
    assert manifest is not None and recorded is not None
    assert manifest.derived_from == {"options": HASH, "boxes": "2" * 64, "recorded": recorded.content}
    with pytest.raises(DatasetError, match="exists already"):
        first.open()


@pytest.mark.parametrize(
    ("hashes", "named"),
    [
        ({"options": "0" * 64}, "options"),
        ({"boxes": None}, "boxes"),
        ({"masks": HASH}, "masks"),
        ({"recorded": "0" * 64}, "recorded"),
        ({"options": "0" * 64, "masks": HASH}, "masks, options"),
    ],
)
def test_layers_of_other_inputs_are_refused(
    layers: list[DerivedLayer], hashes: dict[str, str | None], named: str
) -> None:
    write(layers[0])
    change_record(layers[0].folder, **hashes)
    before = (layers[0].folder / "manifest.json").read_bytes()
    with pytest.raises(DatasetError, match="the same options") as refused:
        find_missing(layers)
    assert refused.value.place == f"derived_from: {named}" and "--version" in str(refused.value)
    assert (layers[0].folder / "manifest.json").read_bytes() == before
    other = replace(layers[0], version="2")
    assert not other.exists()
    write(other)
    assert other.exists()


def test_what_only_the_work_yields_is_recorded_and_does_not_decide(layers: list[DerivedLayer]) -> None:
    layer = replace(layers[0], not_compared=frozenset({"found"}))
    write(layer, found="3" * 64)
    manifest = read_manifest(layer.folder)
    assert layer.exists() and manifest is not None and manifest.derived_from["found"] == "3" * 64


@pytest.mark.parametrize("shows_images", [False, True])
def test_layers_that_show_images_are_those_of_other_inputs_after_a_redaction(
    layers: list[DerivedLayer], shows_images: bool
) -> None:
    layer = replace(layers[0], not_compared=frozenset()) if shows_images else layers[0]
    write(layer)
    assert layer.exists()
    LayerWriter(layer.layout, layer.traversal_id, REDACTION, "deidentify", "1").finish(IMAGES, [])
    if shows_images:
        with pytest.raises(DatasetError) as refused:
            layer.exists()
        assert refused.value.place == f"derived_from: {REDACTION}"
    else:
        assert layer.exists()
    later = replace(layer, version="2")
    write(later)
    assert later.exists()


def test_the_folder_of_a_verb_goes_with_its_last_work(tmp_path: Path) -> None:
    layout = Layout(tmp_path)
    one, other = (work_folder(layout, REFINEMENT, "refined@1", inputs) for inputs in ("a" * 64, "b" * 64))
    for folder in (one, other):
        (folder / "deep").mkdir(parents=True)
    remove_work(one)
    assert other.is_dir() and not one.exists()
    remove_work(other)
    remove_work(work_folder(layout, DEPTH, "sweep@1", HASH))
    assert list(tmp_path.iterdir()) == []
