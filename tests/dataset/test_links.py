"""Links that lead out of a dataset or a bundle: refused on read and on write, before anything is touched outside."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.dataset.index.build import build_index
from mirror.dataset.layout import Layout
from mirror.dataset.lock import writer_lock
from mirror.errors import DatasetError
from mirror.export.fetch import fetch
from mirror.schema.links import refuse_links_out, require_inside
from tests.evaluation.submissions import SPLIT
from tests.export.leaving import copied, publish_to, sealed


@pytest.fixture
def root(tiny_dataset: Dataset, tmp_path: Path) -> Path:
    return copied(tiny_dataset, tmp_path / "dataset")


def lead_out(path: Path) -> Path:
    """Move a file or folder out of its dataset, and leave a link; returns its place."""
    outside = next(parent for parent in path.parents if (parent / "dataset").exists() or (parent / "d").exists())
    moved = Path(shutil.move(path, outside / "outside"))
    path.symlink_to(moved)
    return moved


def read_images(root: Path) -> object:
    return mirror.open(root).table("images")


def decode_images(root: Path) -> object:
    return [frame.decode() for frame in mirror.open(root).where(camera="front_wide").frames()]


def read_masks(root: Path) -> object:
    return mirror.open(root).frames()[0].images["front_wide"].static_mask()


@pytest.mark.parametrize(
    ("pattern", "read"),
    [
        ("index/*/images/*.parquet", read_images),
        ("index/*/images", read_images),
        ("index/*/manifest.json", read_images),
        ("index/snapshots", read_images),
        ("index/snapshots/*.json", read_images),
        ("index", read_images),
        ("dataset.json", read_images),
        ("traversals", decode_images),
        ("traversals/*/recorded", decode_images),
        ("traversals/*/recorded/front_wide", decode_images),
        ("traversals/*/recorded/front_wide/*.jpg", decode_images),
        ("rigs/*.json", decode_images),
    ],
)
def test_reading_through_a_link_that_leads_out_is_refused(
    root: Path, pattern: str, read: Callable[[Path], object]
) -> None:
    read(root)
    moved = lead_out(sorted(root.glob(pattern))[0])
    with pytest.raises(DatasetError, match="it leads out of its folder") as caught:
        read(root)
    assert str(moved) in caught.value.problem
    # A link to another place of the same folder is followed.
    (link,) = [path for path in root.rglob("*") if path.is_symlink()]
    link.unlink()
    shutil.move(moved, root / "moved")
    link.symlink_to(root / "moved")
    read(root)


@pytest.mark.parametrize(
    "pattern", ["index/*/images/*.parquet", "traversals/*/layers", "splits", "drives/*/drive.json"]
)
def test_every_verb_that_walks_a_dataset_refuses_a_link(root: Path, tmp_path: Path, pattern: str) -> None:
    lead_out(sorted(root.glob(pattern))[0])
    out = tmp_path / "out"
    with pytest.raises(DatasetError, match="leads out"), writer_lock(Layout(root), wait=False):
        pass
    for words in (
        ["check", str(root)],
        ["index", str(root)],
        ["dataset", "publish", str(root), "--split", SPLIT, "--licence", "CC0-1.0", "--out", str(out)],
        ["dataset", "audit", str(root), "--against", str(root)],
        ["deidentify", str(root), "--detector", "centerface", "--plate-region", "none"],
    ):
        assert main(words) == 2, words
    assert not (out / "bundle.json").exists()


@pytest.mark.parametrize("name", ["traversals", "index", "drives", "rigs", "bundle.json"])
def test_writing_through_a_link_that_leads_out_is_refused(root: Path, tmp_path: Path, name: str) -> None:
    bundle, outside = tmp_path / "d", tmp_path / "outside"
    sealed(publish_to(root, bundle))
    fetch(str(bundle), tmp_path / "fetched")
    for folder in (tmp_path / "fetched", bundle):
        (folder / name).rename(folder / f"{name}-was")
        target = outside / folder.name
        if name == "bundle.json":
            outside.mkdir(exist_ok=True)
            shutil.copyfile(folder / f"{name}-was", target)
        else:
            shutil.copytree(folder / f"{name}-was", target)
            (target / "mine.txt").write_text("not yours")
        shutil.rmtree(folder / f"{name}-was", ignore_errors=True)
        (folder / name).symlink_to(target)
    before = {path: path.read_bytes() for path in outside.rglob("*") if path.is_file()}
    with pytest.raises(DatasetError, match="leads out"):
        fetch(str(root.parent / "d"), tmp_path / "fetched")
    with pytest.raises(DatasetError, match="leads out"):
        publish_to(root, bundle)
    assert {path: path.read_bytes() for path in outside.rglob("*") if path.is_file()} == before


def test_a_dataset_may_itself_be_a_link_and_hold_links_to_itself(root: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(root)
    assert read_images(tmp_path / "link").num_rows
    (root / "splits" / "same.json").symlink_to(f"{SPLIT}.json")
    (root / "broken").symlink_to("nothing")
    refuse_links_out(tmp_path / "link")
    build_index(tmp_path / "link")
    for path in ("../other", "a/../../b"):
        with pytest.raises(DatasetError, match="leads out"):
            require_inside(root, path)
    assert require_inside(root, "traversals/none/x.jpg") == root / "traversals" / "none" / "x.jpg"


def test_a_rig_or_manifest_whose_paths_lead_out_is_refused(root: Path) -> None:
    rig = sorted(root.glob("rigs/*.json"))[0]
    text = rig.read_text()
    start = text.index('"static_mask": ') + len('"static_mask": ')
    end = min(text.index(mark, start) for mark in ("\n", ","))
    for path in ("../../secret.png", "/etc/hostname"):
        rig.write_text(f'{text[:start]}"{path}"{text[end:]}')
        with pytest.raises(mirror.errors.SchemaError, match="leads out of its folder"):
            build_index(root)
