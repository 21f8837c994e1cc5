"""What leaves a dataset: what is named, no original, no withheld image in whatever file, nothing that changed."""

from __future__ import annotations

import base64
import hashlib
import io
import json
import shutil
import tarfile
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.dataset.door.files import list_dataset_files
from mirror.dataset.index.build import build_index
from mirror.dataset.layer_writer import LayerWriter
from mirror.dataset.layout import Layout, manifest_sha256, seal
from mirror.errors import DatasetError
from mirror.export.audit import audit
from mirror.export.document import MANIFEST, UNFINISHED
from mirror.export.run import ExportOptions, export
from mirror.geometry.poses import COLUMNS
from mirror.progress import NullProgress
from mirror.protocols.views import plan_views
from mirror.schema.bundle import BUNDLE
from mirror.schema.documents import FileEntry, Manifest
from mirror.schema.files import encode_table, read_json, read_table, sha256_bytes, write_bytes, write_json
from mirror.schema.tables import IMAGES, LIDARS, MASKS
from mirror.synth import SynthReport
from tests.evaluation.submissions import SPLIT, small
from tests.export.leaving import copied, publish_to, recorded_images, redact, sealed, write_three_cameras


@pytest.fixture(scope="module")
def street(tiny_recordings: SynthReport, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """The street through three of its cameras, since every image is hashed and decoded; tests do not change it."""
    return write_three_cameras(tiny_recordings.recordings[:2], tmp_path_factory.mktemp("street"))


@pytest.fixture
def root(street: Dataset, tmp_path: Path) -> Path:
    return copied(street, tmp_path / "dataset")


@pytest.fixture(scope="module")
def redacted_street(street: Dataset, tmp_path_factory: pytest.TempPathFactory) -> Dataset:
    """The street with a redaction layer; tests do not change it."""
    root = copied(street, tmp_path_factory.mktemp("redacted") / "dataset")
    redact(root)
    return mirror.open(root)


@pytest.fixture
def redacted(redacted_street: Dataset, tmp_path: Path) -> Path:
    return copied(redacted_street, tmp_path / "dataset")


def held_out(root: Path) -> str:
    return str(mirror.open(root).where(split=SPLIT, role="held_out").traversals()[0])


def train(root: Path) -> str:
    return str(mirror.open(root).where(split=SPLIT, role="train").traversals()[0])


def files_below(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def refused(root: Path, out: Path, *words: str) -> None:
    """Publishing is refused by the command line, and its words name what leaks."""
    report = publish_to(root, out)
    assert report.bundle is None
    assert not (out / BUNDLE).exists()
    text = " ".join(f"{one.file} {one.problem}" for one in report.leaks)
    for word in words:
        assert word in text


def test_an_image_that_was_blanked_is_blank_in_the_bundle(root: Path, tmp_path: Path) -> None:
    out = tmp_path / "bundle"
    name = next(path for path in sealed(publish_to(root, out)).files if path.endswith(".jpg"))
    blank = cv2.imencode(".jpg", np.zeros((4, 4, 3), np.uint8))[1].tobytes()
    (root / name).unlink()
    (root / name).write_bytes(blank)
    report = publish_to(root, out)
    entry = sealed(report).files[name]
    assert (out / name).read_bytes() == blank
    assert (entry.bytes, entry.sha256) == (len(blank), hashlib.sha256(blank).hexdigest())
    assert report.altered == (name,)


def test_no_original_of_a_de_identified_dataset_leaves(redacted: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "bundle"
    words = ["dataset", "publish", str(redacted), "--split", SPLIT, "--licence", "CC0-1.0", "--out", str(out)]
    assert main(words) == 0
    assert "as recorded" not in capsys.readouterr().out
    originals = recorded_images(redacted)
    published = files_below(out)
    assert originals
    assert set(originals.values()).isdisjoint(published.values())
    assert not [name for name in published if "/recorded/" in name and name.endswith(".jpg")]
    assert not [name for name in published if held_out(redacted) in name and name.endswith(".jpg")]
    images = [name for name in published if name.endswith(".jpg")]
    assert images
    assert all(f"traversals/{train(redacted)}/layers/redaction/" in name for name in images)
    for name, data in files_below(redacted).items():
        if name.endswith(".parquet") and not name.startswith("index/") and "/depth/" not in name:
            assert published[name] == data
    assert plan_views(mirror.open(out), small(), SPLIT).hash == plan_views(mirror.open(redacted), small(), SPLIT).hash
    assert not [finding for rule, finding in mirror.check(out).findings if rule.rule_id in ("IMG001", "FIL001")]
    shown = [image for frame in mirror.open(out).frames() for image in frame.images.values() if image.uri in images]
    assert len(shown) == len(images)
    assert shown[0].decode(verify=True).any()


def test_the_warning_about_faces_counts_what_leaves(root: Path, tmp_path: Path) -> None:
    report = publish_to(root, tmp_path / "raw")
    assert report.as_recorded == sum(name.endswith(".jpg") for name in sealed(report).files) > 0
    redact(root)
    assert publish_to(root, tmp_path / "redacted").as_recorded == 0


def test_what_a_redaction_left_out_and_older_redactions_stay(redacted: Path, tmp_path: Path) -> None:
    stamps = mirror.open(redacted).where(traversal=train(redacted)).table("images", ["timestamp_ns"]).column(0)
    lost = stamps[0].as_py()
    redact(redacted, version="2", without=frozenset({lost}))
    bundle = sealed(publish_to(redacted, tmp_path / "bundle"))
    images = [name for name in bundle.files if name.endswith(".jpg")]
    assert images
    assert all("/redaction/corner@2/" in name for name in images)
    assert not [name for name in images if str(lost) in name]
    assert [name for name in bundle.withheld if f"{train(redacted)}/recorded/" in name and str(lost) in name]


def test_references_to_the_files_of_a_fleet_do_not_leave(root: Path, tmp_path: Path) -> None:
    """The paths of lidar sweeps stay in the dataset, and an audit finds them outside."""
    layout = Layout(root)
    place = f"traversals/{train(root)}/layers/lidars/recorded@1"
    stamp = mirror.open(root).where(traversal=train(root)).frames()[0].timestamp_ns
    pose = {name: float(name == "qw") for name in COLUMNS}
    row = {"sensor": "top", "timestamp_ns": stamp, "format": "dgp_npz", "uri": "/fleet/car-7/sweep.npz", **pose}
    data = encode_table(pa.Table.from_pylist([row], schema=LIDARS.schema), LIDARS)
    write_bytes(root / place / "lidars.parquet", data)
    seal(root / place, {"lidars.parquet": data}, derived_from={})
    build_index(root)
    assert mirror.open(root).where(traversal=train(root)).frames()[0].lidars[0].uris == (row["uri"],)
    assert not any("lidars" in name for name in list_dataset_files(layout).names)
    bundle = sealed(publish_to(root, tmp_path / "bundle"))
    assert not any("lidars" in name for name in bundle.files)
    assert not any(b"/fleet/car-7" in data for data in files_below(tmp_path / "bundle").values())
    assert mirror.open(tmp_path / "bundle").where(traversal=train(root)).frames()[0].lidars == ()
    assert not audit(str(tmp_path / "bundle"), root).leaks
    shutil.copytree(root / place, tmp_path / "bundle" / place)
    assert {leak.file for leak in audit(str(tmp_path / "bundle"), root).leaks} == {
        f"{place}/lidars.parquet", f"{place}/manifest.json",
    }  # fmt: skip


def test_files_that_nothing_names_do_not_leave(redacted: Path, tmp_path: Path) -> None:
    original = next(iter(recorded_images(redacted).values()))
    strays = ["notes.jpg", "drives/scan.jpg", "splits/held_out.jpg", "rigs/old.png", "maps/view.png"]
    strays += [f"traversals/{train(redacted)}/preview.jpg", f"traversals/{train(redacted)}/layers/boxes/preview.jpg"]
    strays += [f"traversals/{train(redacted)}/layers/previews/mine@1/1.jpg", "raw.mp4", "page.html"]
    for name in strays:
        (redacted / name).parent.mkdir(parents=True, exist_ok=True)
        (redacted / name).write_bytes(original)
    bundle = sealed(publish_to(redacted, tmp_path / "bundle"))
    assert set(strays).isdisjoint(bundle.files)
    assert set(strays).isdisjoint(files_below(tmp_path / "bundle"))


def with_mask(root: Path, data: bytes) -> str:
    """Add a layer with one mask to the training traversal; returns its path."""
    row = mirror.open(root).where(traversal=train(root)).table("images").to_pylist()[0]
    writer = LayerWriter(Layout(root), train(root), "masks", "planted", "1")
    file = writer.file("mask.png", data)
    writer.finish(MASKS, [{"camera": row["camera"], "timestamp_ns": row["timestamp_ns"], "kind": "sky", **file}], {})
    build_index(root)
    return str(file["uri"])


def test_a_withheld_image_as_a_mask_is_refused(redacted: Path, tmp_path: Path) -> None:
    secret = next(data for path, data in recorded_images(redacted).items() if held_out(redacted) in str(path))
    pixels = cv2.imdecode(np.frombuffer(secret, np.uint8), cv2.IMREAD_COLOR)
    name = with_mask(redacted, cv2.imencode(".png", pixels)[1].tobytes())
    refused(redacted, tmp_path / "bundle", name, "pixels of a withheld image")


def test_an_original_in_place_of_its_redacted_image_is_refused(redacted: Path, tmp_path: Path) -> None:
    first = next(iter(sorted(redacted.glob(f"traversals/{train(redacted)}/layers/redaction/*/*/*.jpg"))))
    original = redacted / "traversals" / train(redacted) / "recorded" / first.parent.name / first.name
    first.unlink()
    first.write_bytes(original.read_bytes())
    refused(redacted, tmp_path / "bundle", first.name, "the original of a redacted image")


def test_a_table_that_names_a_file_of_another_folder_is_refused(redacted: Path, tmp_path: Path) -> None:
    row = mirror.open(redacted).where(traversal=held_out(redacted)).table("images").to_pylist()[0]
    secret = next(path for path in recorded_images(redacted) if held_out(redacted) in str(path))
    data = secret.read_bytes()
    planted = {"camera": row["camera"], "timestamp_ns": row["timestamp_ns"], "kind": "sky"}
    planted |= {"uri": secret.relative_to(redacted).as_posix(), "byte_length": len(data), "sha256": bytes(32)}
    LayerWriter(Layout(redacted), train(redacted), "masks", "planted", "1").finish(MASKS, [planted], {})
    build_index(redacted)
    with pytest.raises(DatasetError, match="the table names the file"):
        publish_to(redacted, tmp_path / "bundle")
    assert not (tmp_path / "bundle" / BUNDLE).exists()


def test_a_picture_that_a_manifest_names_is_refused(root: Path, tmp_path: Path) -> None:
    writer = LayerWriter(Layout(root), train(root), "boxes", "planted", "1")
    writer.document("preview.jpg", next(iter(recorded_images(root).values())))
    from mirror.schema.tables import BOXES

    writer.finish(BOXES, [], {})
    build_index(root)
    with pytest.raises(DatasetError, match=r"names preview\.jpg"):
        publish_to(root, tmp_path / "bundle")


def test_equal_bytes_under_a_published_key_are_named(root: Path, tmp_path: Path) -> None:
    """A parked car: an image of the held-out traversal has the bytes of a published one."""
    layout, hidden = Layout(root), held_out(root)
    shown = mirror.open(root).where(traversal=train(root)).table("images").to_pylist()[0]
    data = (root / shown["uri"]).read_bytes()
    folder = layout.recorded(hidden)
    rows = read_table(folder / "images.parquet", IMAGES).to_pylist()
    row = next(one for one in rows if one["camera"] == shown["camera"])
    (root / row["uri"]).unlink()
    (root / row["uri"]).write_bytes(data)
    row |= {"byte_length": len(data), "sha256": hashlib.sha256(data).digest()}
    reseal(layout, hidden, rows)
    report = publish_to(root, tmp_path / "bundle")
    key = f"{train(root)}/{shown['camera']}/{shown['timestamp_ns']}"
    assert [(one.shown, one.kept) for one in report.same_bytes] == [
        (key, f"{hidden}/{row['camera']}/{row['timestamp_ns']}")
    ]
    assert shown["uri"] in sealed(report).files


def reseal(layout: Layout, traversal_id: str, rows: list[dict]) -> None:
    """Write the images table of a traversal again, and all that depends on its hash but the splits."""
    folder = layout.recorded(traversal_id)
    plain = [field.with_type(pa.string()) if pa.types.is_dictionary(field.type) else field for field in IMAGES.schema]
    data = encode_table(pa.Table.from_pylist(rows, schema=pa.schema(plain)), IMAGES)
    (folder / "images.parquet").unlink()
    (folder / "images.parquet").write_bytes(data)
    manifest = read_json(folder / "manifest.json", Manifest)
    files = {**manifest.files, "images.parquet": FileEntry(bytes=len(data), sha256=sha256_bytes(data))}
    write_json(folder / "manifest.json", manifest.model_copy(update={"files": files}))
    drive = layout.drive(traversal_id.split(".")[1])
    own = read_json(drive / "manifest.json", Manifest)
    hashes = {**own.derived_from, f"traversal:{traversal_id}": manifest_sha256(folder)}
    seal(drive, {name: (drive / name).read_bytes() for name in own.files}, derived_from=hashes)
    build_index(layout.root)


def test_nothing_is_sealed_if_the_dataset_changes_meanwhile(root: Path, tmp_path: Path) -> None:
    from mirror.export.publish import PublishOptions, publish

    class Changing(NullProgress):
        def start(self, phase: str, total: int) -> None:
            if phase == "inspecting":
                redact(root)

    options = PublishOptions(split=SPLIT, protocols=(small(),), name="Street", licence="CC0-1.0")
    with pytest.raises(DatasetError, match="changed while it was read"):
        publish(root, str(tmp_path / "bundle"), options, progress=Changing())
    assert not (tmp_path / "bundle" / BUNDLE).exists()


def archive(data: bytes) -> bytes:
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED) as held:
        held.writestr("a/preview.jpg", data)
    return sink.getvalue()


def shard(data: bytes) -> bytes:
    sink = io.BytesIO()
    with tarfile.open(fileobj=sink, mode="w:gz") as held:
        member = tarfile.TarInfo("1.jpg")
        member.size = len(data)
        held.addfile(member, io.BytesIO(data))
    return sink.getvalue()


def table(data: bytes) -> bytes:
    sink = io.BytesIO()
    pq.write_table(pa.table({"image": [{"bytes": data, "path": "1.jpg"}]}), sink, compression="zstd")
    return sink.getvalue()


def page(data: bytes) -> bytes:
    return f'<html><img src="data:image/jpeg;base64,{base64.b64encode(data).decode()}"></html>'.encode()


def model(data: bytes) -> bytes:
    return b"\x40\0\0\0\0\0\0\0" + json.dumps({"weights": 1}).encode().ljust(64) + bytes(997) + data + bytes(500)


def preview(data: bytes) -> bytes:
    return cv2.imencode(".png", cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))[1].tobytes()


def page_of_previews(data: bytes) -> bytes:
    return page(preview(data))


@pytest.mark.parametrize("make", [archive, shard, table, page, model, preview, page_of_previews])
@pytest.mark.parametrize("kind", ["withheld", "original"])
def test_containers_and_pages_are_opened(redacted: Path, tmp_path: Path, make, kind: str) -> None:
    whose = held_out(redacted) if kind == "withheld" else train(redacted)
    images = {path: data for path, data in recorded_images(redacted).items() if whose in str(path)}
    path, data = next(iter(images.items()))
    out = tmp_path / "out"
    out.mkdir()
    (out / "fine.txt").write_bytes(b"text")
    assert not audit(str(out), redacted, split=SPLIT).leaks
    (out / "data.bin").write_bytes(make(data))
    leaks = audit(str(out), redacted, split=SPLIT).leaks
    assert {one.file for one in leaks} == {"data.bin"}
    assert f"{whose}/{path.parent.name}/{path.stem}" in leaks[0].problem


def test_a_bundle_of_an_earlier_version_is_found_out(redacted: Path, tmp_path: Path, capsys) -> None:
    out = tmp_path / "bundle"
    bundle = sealed(publish_to(redacted, out))
    assert main(["dataset", "audit", str(out), "--against", str(redacted)]) == 0
    originals = {path.relative_to(redacted).as_posix(): data for path, data in recorded_images(redacted).items()}
    files = dict(bundle.files)
    for name, data in originals.items():
        (out / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).write_bytes(data)
        files[name] = FileEntry(bytes=len(data), sha256=sha256_bytes(data))
    write_json(out / BUNDLE, bundle.model_copy(update={"files": files}))
    capsys.readouterr()
    assert main(["dataset", "audit", str(out), "--against", str(redacted), "--json"]) == 1
    said = json.loads(capsys.readouterr().out)
    assert {one["file"] for one in said["leaks"]} == set(originals)
    # Publishing again removes them.
    sealed(publish_to(redacted, out))
    assert main(["dataset", "audit", str(out), "--against", str(redacted)]) == 0


def test_an_image_that_was_taken_down_since_is_found(root: Path, tmp_path: Path) -> None:
    out = tmp_path / "bundle"
    name = next(path for path in sealed(publish_to(root, out)).files if path.endswith(".jpg"))
    (root / name).unlink()
    (root / name).write_bytes(b"\xff\xd8\xff\xd9")
    assert [one.file for one in audit(str(out), root).leaks] == [name]


def test_a_file_in_the_folder_of_a_bundle_is_inspected_and_not_listed(root: Path, tmp_path: Path) -> None:
    out = tmp_path / "bundle"
    sealed(publish_to(root, out))
    (out / "CITATION.cff").write_text("mine")
    assert "CITATION.cff" not in sealed(publish_to(root, out)).files
    assert (out / "CITATION.cff").exists()
    secret = next(data for path, data in recorded_images(root).items() if held_out(root) in str(path))
    (out / ".cache").mkdir()
    (out / ".cache" / "x").write_bytes(secret)
    refused(root, out, ".cache/x", "a withheld image")


def test_publishing_to_a_url_again_removes_what_no_longer_leaves(root: Path, tmp_path: Path) -> None:
    import fsspec

    url = f"memory://{tmp_path.name}/street"
    loose = sealed(publish_to(root, url, small(groups='[[groups]]\nname = "n"\nroles = ["held_out"]\n')))
    redact(root)
    strict = sealed(publish_to(root, url))
    filesystem, base = fsspec.core.url_to_fs(url)
    present = {path.removeprefix(f"{base}/") for path in filesystem.find(base)}
    assert present == {*strict.files, BUNDLE}
    assert set(loose.files) - present
    filesystem.pipe_file(f"{base}-other/dataset.json", b"{}")
    with pytest.raises(mirror.errors.UsageError, match="not a published one"):
        publish_to(root, f"{url}-other")


@pytest.mark.parametrize("layout", ["colmap", "kitti", "webdataset", "lerobot"])
def test_an_export_has_no_recorded_image_of_a_redacted_traversal(root: Path, tmp_path: Path, layout: str) -> None:
    chosen = train(root)
    view = mirror.open(root).where(camera="front_wide", traversal=chosen)
    redact(root, without=frozenset({view.table("images", ["timestamp_ns"]).column(0)[0].as_py()}))
    dataset = mirror.open(root).where(camera=["front_wide", "rear"], traversal=chosen)
    out = tmp_path / "out"
    written = export(dataset, layout, out, ExportOptions(undistort=layout in ("colmap", "kitti")))
    assert written.withheld == 1
    assert not audit(str(out), root).leaks
    # Another run of the same call finds a file that must not be there, and seals nothing.
    images = recorded_images(root).items()
    original = next(data for path, data in images if path.parent.name == "rear" and chosen in str(path))
    (out / MANIFEST).unlink()
    write_json(out / UNFINISHED, written.request)
    (out / "preview.jpg").write_bytes(original)
    with pytest.raises(DatasetError, match="the original of a redacted image"):
        export(dataset, layout, out, ExportOptions(undistort=layout in ("colmap", "kitti")))
    assert not (out / MANIFEST).exists()


@pytest.mark.parametrize(("layout", "undistort"), [("colmap", False), ("kitti", True), ("webdataset", False)])
def test_an_export_shows_images_as_they_are_now(root: Path, tmp_path: Path, layout: str, undistort: bool) -> None:
    dataset = mirror.open(root).where(camera="rear")
    out, whole = tmp_path / "out", tmp_path / "whole"
    export(dataset, layout, out, ExportOptions(undistort=undistort))
    row = dataset.table("images").to_pylist()[0]
    pixels = np.zeros((row["height_px"], row["width_px"], 3), np.uint8)
    data = cv2.imencode(".jpg", pixels)[1].tobytes()
    data += bytes(row["byte_length"] - len(data))
    blank = data[: -len(b"\xff\xd9")] + b"\xff\xd9"
    assert len(blank) == row["byte_length"]
    (root / row["uri"]).unlink()
    (root / row["uri"]).write_bytes(blank)
    export(dataset, layout, out, ExportOptions(undistort=undistort))
    export(dataset, layout, whole, ExportOptions(undistort=undistort))
    assert files_below(out) == files_below(whole)


def test_a_photo_saved_as_the_mask_of_a_rig_is_published_as_an_outline(root: Path, tmp_path: Path) -> None:
    masks = sorted(root.glob("rigs/*.png"))
    image = cv2.imread(str(next(root.glob("traversals/*/recorded/*/*.jpg"))), cv2.IMREAD_GRAYSCALE)
    for mask in masks:
        cv2.imwrite(str(mask), image)
    bundle = sealed(publish_to(root, tmp_path / "out"))
    assert masks
    for mask in masks:
        published = tmp_path / "out" / "rigs" / mask.name
        pixels = cv2.imread(str(published), cv2.IMREAD_UNCHANGED)
        assert np.array_equal(pixels, (image > 0) * 255)
        assert bundle.files[f"rigs/{mask.name}"].sha256 == hashlib.sha256(published.read_bytes()).hexdigest()
