"""An export links images, resumes, refuses other requests, and respects what is withheld or replaced."""

from __future__ import annotations

import csv
import io
import json
import shutil
import tarfile
from pathlib import Path

import pytest
from PIL import Image, ImageOps

import mirror
from mirror.dataset.dataset import Dataset
from mirror.dataset.index.build import build_index
from mirror.dataset.layout import Layout
from mirror.errors import DatasetError, UsageError
from mirror.export.document import MANIFEST, UNFINISHED
from mirror.export.layouts_page import layouts_page
from mirror.export.publish import PublishOptions, publish
from mirror.export.run import LAYOUTS, ExportOptions, export, find_layout
from mirror.protocols.document import load_protocol
from mirror.schema.tables import IMAGES
from tests.builders.dataset import Builder
from tests.builders.street import encoded, make_street
from tests.interruption import InterruptingProgress

pytest.importorskip("pycolmap")
CAMERAS = ("front_wide", "front_narrow")


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    return make_street(tmp_path_factory.mktemp("street") / "dataset", CAMERAS)


def files_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_images_are_links_and_the_dataset_stays_as_it_was(street: Dataset, tmp_path: Path) -> None:
    before = files_of(Path(street.root))
    export(street, "colmap", tmp_path / "out")
    export(street, "colmap", tmp_path / "copies", ExportOptions(copies=True))
    rows = list(csv.DictReader((tmp_path / "out" / "images.csv").open()))
    assert len(rows) == 20
    images = street.table("images").to_pylist()
    uris = {(row["traversal_id"], row["camera"], row["timestamp_ns"]): row["uri"] for row in images}
    for row in rows:
        source = Path(street.root) / uris[row["traversal_id"], row["camera"], int(row["timestamp_ns"])]
        assert (tmp_path / "out" / row["file"]).samefile(source)
        copy = tmp_path / "copies" / row["file"]
        assert not copy.samefile(source)
        assert copy.read_bytes() == source.read_bytes()
    assert files_of(Path(street.root)) == before


@pytest.mark.parametrize("steps", [0, 7, 20, 30])
def test_an_interrupted_export_continues(street: Dataset, tmp_path: Path, steps: int) -> None:
    options = ExportOptions(split="novel", undistort=True)
    out = tmp_path / "out"
    with pytest.raises(KeyboardInterrupt):
        export(street, "nerfstudio", out, options, progress=InterruptingProgress(steps + 1))
    assert not (out / MANIFEST).exists()
    assert (out / UNFINISHED).is_file()
    with pytest.raises(UsageError, match="another split"):
        export(street, "nerfstudio", out, ExportOptions(undistort=True))
    # What a process leaves behind that is killed while it writes; other hidden files are not its own.
    left = [out / ".images.csv.77.tmp", out / "deep" / "folder" / ".a.jpg.123456.tmp"]
    for file in left:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(b"half")
    (out / "deep" / ".mine.tmp").write_bytes(b"mine")
    written = export(street, "nerfstudio", out, options)
    assert not any(file.exists() for file in left) and (out / "deep" / ".mine.tmp").exists()
    shutil.rmtree(out / "deep")
    whole = export(street, "nerfstudio", tmp_path / "whole", options)
    assert written == whole
    assert files_of(out) == files_of(tmp_path / "whole")
    assert not [name for name in files_of(out) if name.endswith(".tmp")]


def test_a_complete_export_is_kept_and_another_is_refused(street: Dataset, tmp_path: Path) -> None:
    out = tmp_path / "out"
    first = export(street, "colmap", out)
    stamps = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    assert export(street, "colmap", out) == first
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*")} == stamps
    with pytest.raises(UsageError, match="an export with another layout"):
        export(street, "gsplat", out)
    with pytest.raises(UsageError, match="another traversals"):
        export(street.where(light="night"), "colmap", out)
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "thesis.txt").write_text("mine")
    with pytest.raises(UsageError, match="a folder with other files"):
        export(street, "colmap", tmp_path / "other")
    with pytest.raises(UsageError, match="inside"):
        export(street, "colmap", Path(street.root) / "out")


def test_a_missing_image_is_named(tmp_path: Path) -> None:
    street = make_street(tmp_path / "dataset", CAMERAS)
    (missing,) = street.where(camera="front_wide").table("images").slice(0, 1).to_pylist()
    (tmp_path / "dataset" / missing["uri"]).unlink()
    with pytest.raises(DatasetError, match=f"front_wide, timestamp_ns {missing['timestamp_ns']}"):
        export(street, "colmap", tmp_path / "out")
    assert not (tmp_path / "out" / MANIFEST).exists()
    (tmp_path / "dataset" / missing["uri"]).write_bytes(encoded("front_wide", 0))
    assert export(street, "colmap", tmp_path / "out").images == 20


def test_withheld_images_are_left_out(tmp_path: Path) -> None:
    make_street(tmp_path / "dataset", CAMERAS)
    options = PublishOptions("novel", (load_protocol("static-reconstruction"),), "street", licence="CC-BY-4.0")
    bundle = publish(tmp_path / "dataset", str(tmp_path / "public"), options).bundle
    assert bundle is not None
    # Images of another drive that the publisher's folder should not have: the list decides, not the disk.
    leaked = tmp_path / "public" / bundle.withheld[0]
    leaked.parent.mkdir(parents=True, exist_ok=True)
    leaked.write_bytes((tmp_path / "dataset" / bundle.withheld[0]).read_bytes())
    written = export(mirror.open(tmp_path / "public"), "colmap", tmp_path / "out")
    assert written.withheld == len(bundle.withheld) > 0
    assert written.images == 20 - written.withheld
    exported = {Path(row["file"]).name for row in csv.DictReader((tmp_path / "out" / "images.csv").open())}
    assert exported.isdisjoint(Path(name).name for name in bundle.withheld)


def test_redacted_images_are_exported_and_never_the_recorded_ones(tmp_path: Path) -> None:
    street = make_street(tmp_path / "dataset", CAMERAS)
    traversal = street.traversals()[0]
    names = [field.name for field in IMAGES.schema]
    rows = [
        {name: row[name] for name in names} for row in street.where(traversal=traversal).table("images").to_pylist()
    ]
    for row in rows:
        data = encoded(row["camera"], 7)
        row["uri"] = row["uri"].replace("/recorded/", "/layers/redaction/moved@1/")
        row["byte_length"], row["privacy"] = len(data), "redacted"
        path = tmp_path / "dataset" / row["uri"]
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    builder = Builder.__new__(Builder)
    builder.layout = Layout(tmp_path / "dataset")
    Builder.layer(builder, traversal, "redaction", "moved@1", IMAGES, rows)
    build_index(tmp_path / "dataset")
    export(mirror.open(tmp_path / "dataset").where(traversal=traversal), "colmap", tmp_path / "out")
    for row in csv.DictReader((tmp_path / "out" / "images.csv").open()):
        assert row["privacy"] == "redacted"
        assert (tmp_path / "out" / row["file"]).read_bytes() == encoded(row["camera"], 7)


def test_every_layout_states_what_it_keeps_and_loses(street: Dataset, tmp_path: Path) -> None:
    for name in LAYOUTS:
        layout = find_layout(name)
        assert layout.name == name
        assert layout.kept
        assert layout.lost
        written = export(street, name, tmp_path / name, ExportOptions(undistort=True))
        document = json.loads((tmp_path / name / MANIFEST).read_text())
        assert document["lost"] == list(layout.lost)
        assert written.images == 20
        for path, entry in document["files"].items():
            assert (tmp_path / name / path).stat().st_size == entry["bytes"]
    with pytest.raises(UsageError, match="no export format 'blender'"):
        find_layout("blender")


def test_the_page_states_what_the_code_does() -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "export.md").read_text()
    assert layouts_page() in page


def test_a_dataset_without_points_is_warned_of(street: Dataset, tmp_path: Path) -> None:
    bare = make_street(tmp_path / "dataset", CAMERAS)
    for folder in (tmp_path / "dataset").glob("traversals/*/layers/points"):
        shutil.rmtree(folder)
    build_index(tmp_path / "dataset")
    bare = mirror.open(tmp_path / "dataset")
    for name, warned in (("colmap", True), ("nerfstudio", True), ("gsplat", True), ("webdataset", False)):
        written = export(bare, name, tmp_path / name, ExportOptions(undistort=True))
        assert any("`mirror depth " in note for note in written.notes) == warned, name
    assert not any("mirror depth" in note for note in export(street, "colmap", tmp_path / "with").notes)


@pytest.mark.parametrize("where", ["exif", "xmp"])
def test_exports_state_no_orientation(tmp_path: Path, where: str) -> None:
    """Rasters are those of the calibration; Pillow turns an image by its orientation, as many tools do."""
    exif = Image.Exif()
    exif[0x0112] = 6
    more = {"exif": exif.tobytes()} if where == "exif" else {"xmp": b'<x:xmpmeta tiff:Orientation="6"/>'}

    def turned(camera: str, drive: int) -> bytes:
        data = io.BytesIO()
        Image.open(io.BytesIO(encoded(camera, drive))).save(data, "jpeg", **more)
        return data.getvalue()

    street = make_street(tmp_path / "dataset", CAMERAS, encode=turned)
    assert ImageOps.exif_transpose(Image.open(io.BytesIO(turned("front_wide", 0)))).size == (128, 192)
    for name in ("colmap", "webdataset"):
        export(street, name, tmp_path / name)
    with tarfile.open(tmp_path / "webdataset" / "all-000000.tar") as tar:
        tar.extractall(tmp_path / "tar", filter="data")
    found = [*(tmp_path / "colmap").rglob("*.jpg"), *(tmp_path / "tar").rglob("*.jpg")]
    assert len(found) == 40
    for path in found:
        with Image.open(path) as image:
            assert ImageOps.exif_transpose(image).size == image.size == (192, 128)
