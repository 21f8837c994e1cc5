"""Images that change under their names: what was found in the bytes before is never used for those that came after."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.images.decoding import decode_rgb
from mirror.dataset.index import build_index
from mirror.dataset.layout import Layout, read_manifest, seal
from mirror.errors import DatasetError
from mirror.integrity import check
from mirror.privacy.log import encode_log, read_log
from mirror.privacy.release.check import check_release
from mirror.privacy.run import deidentify
from mirror.schema.documents import ImageTotals
from mirror.schema.files import encode_table, read_table, write_bytes
from mirror.schema.tables import IMAGES
from tests.builders.dataset import SECOND, Builder, Pass
from tests.interruption import interrupt_before
from tests.killed_after_a_layer import require_resumable
from tests.privacy.conftest import RED, make_dataset, marked, options
from tests.privacy.images import jpeg

BEFORE, AFTER = (20, 10, 36, 30), (80, 40, 96, 60)
ONLY = "a.d0.1700000000000"


def record(root: Path, box: tuple[int, int, int, int]) -> None:
    """One drive whose images show a face in a box, at the same names and stamps whatever the box is."""
    for name in ("traversals", "drives", "rigs", "index"):
        shutil.rmtree(root / name, ignore_errors=True)
    builder = Builder(root, cameras=("front_wide",), size=(128, 72))
    builder.scene("a")
    image = jpeg(marked(1, (box, RED)), subsampling=0)
    taken = Pass("a", 1_700_000_000 * SECOND, frames=3, frame_ns=4 * SECOND, images={"front_wide": image})
    builder.drive("d0", [taken], vehicle_id="v0")
    build_index(root)


def shows_face(data: bytes, box: tuple[int, int, int, int]) -> bool:
    left, top, right, bottom = box
    return bool((np.abs(np.diff(decode_rgb(data, "jpeg")[top:bottom, left:right].astype(int), axis=1)) > 40).any())


def test_detections_of_other_bytes_are_not_used(tmp_path: Path) -> None:
    root = tmp_path / "dataset"
    record(root, BEFORE)
    with interrupt_before("layers/*/*"):
        deidentify(root, options())
    assert list((root / ".deidentify").rglob("*.jsonl"))
    record(root, AFTER)
    assert deidentify(root, options()).exit_code() == 0
    for image in (frame.images["front_wide"] for frame in mirror.open(root).frames()):
        assert image.privacy == "redacted" and not shows_face(image.read(), AFTER)
    folder = Layout(root).layer(ONLY, "redaction", "deidentify", "1")
    for line in read_log(folder / "log.jsonl"):
        recorded = root / f"traversals/{ONLY}/recorded/{line.camera}/{line.timestamp_ns}.jpg"
        assert line.source_sha256 == hashlib.sha256(recorded.read_bytes()).hexdigest()
    assert check(root, cost=2).exit_code() == 0


def test_detections_of_the_same_bytes_are_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    root = tmp_path / "dataset"
    record(root, BEFORE)
    with interrupt_before("layers/*/*"):
        deidentify(root, options())
    searched: list[int] = []

    def counted(self: object, tasks: list[object]) -> object:
        searched.append(len(tasks))
        return iter(())

    with monkeypatch.context() as patched:
        patched.setattr("mirror.privacy.detection.DetectionPool.map", counted)
        assert deidentify(root, options()).exit_code() == 0
    assert set(searched) == {0}


def test_images_without_a_recorded_hash_are_hashed(tmp_path: Path) -> None:
    root = tmp_path / "dataset"
    for box, stop in ((BEFORE, True), (AFTER, False)):
        record(root, box)
        forget_hashes(root)
        if stop:
            with interrupt_before("layers/*/*"):
                deidentify(root, options())
    assert deidentify(root, options()).exit_code() == 0
    assert not any(shows_face(frame.images["front_wide"].read(), AFTER) for frame in mirror.open(root).frames())


def forget_hashes(root: Path) -> None:
    """Make a dataset what an ingest without hashes makes."""
    layout = Layout(root)
    folder = layout.recorded(ONLY)
    rows = [{**row, "sha256": None} for row in read_table(folder / "images.parquet", IMAGES).to_pylist()]
    manifest = read_manifest(folder)
    files = {name: (folder / name).read_bytes() for name in manifest.files}
    plain = pa.schema([
        field.with_type(pa.string()) if pa.types.is_dictionary(field.type) else field for field in IMAGES.schema
    ])  # fmt: skip
    files["images.parquet"] = encode_table(pa.Table.from_pylist(rows, schema=plain), IMAGES)
    write_bytes(folder / "images.parquet", files["images.parquet"])
    seal(folder, files, derived_from=manifest.derived_from, images=ImageTotals(count=len(rows), bytes=0))
    drive = layout.drive("d0")
    before = read_manifest(drive)
    derived = {
        **before.derived_from,
        f"traversal:{ONLY}": hashlib.sha256((folder / "manifest.json").read_bytes()).hexdigest(),
    }
    seal(drive, {name: (drive / name).read_bytes() for name in before.files}, derived_from=derived)
    build_index(root)


def test_masks_of_an_interrupted_run_on_other_bytes_are_written_again(tmp_path: Path) -> None:
    root = tmp_path / "dataset"
    record(root, BEFORE)
    with interrupt_before("layers/redaction/*"):
        deidentify(root, options())
    masks = Layout(root).layer(ONLY, "masks", "deidentify", "1")
    assert read_manifest(masks) is not None
    kept = shutil.copytree(masks, tmp_path / "masks")
    record(root, AFTER)
    shutil.copytree(kept, masks)
    build_index(root)
    assert deidentify(root, options()).exit_code() == 0
    for image in (frame.images["front_wide"] for frame in mirror.open(root).frames()):
        (mask,) = image.masks()
        left, top, right, bottom = AFTER
        assert (mask.decode()[top:bottom, left:right] > 0).all()


def test_a_layer_of_other_recorded_images_is_not_called_done(tmp_path: Path) -> None:
    root = tmp_path / "dataset"
    record(root, BEFORE)
    assert deidentify(root, options()).exit_code() == 0
    layers = shutil.copytree(root / "traversals" / ONLY / "layers", tmp_path / "layers")
    record(root, AFTER)
    shutil.copytree(layers, root / "traversals" / ONLY / "layers")
    build_index(root)
    assert "PRV005" in {rule.rule_id for rule, _ in check(root, only=["PRV"]).findings}
    with pytest.raises(DatasetError, match="derived_from: recorded: ") as refused:
        deidentify(root, options())
    assert "--version" in str(refused.value)
    words = ["--name", "street", "--licence", "CC0-1.0", "--contact", "a@example.org", "--sample", "0"]
    assert main(["release", "build", str(root), "--out", str(tmp_path / "release"), *words]) == 2
    assert not (tmp_path / "release").exists()
    assert deidentify(root, options(version="2")).exit_code() == 0
    assert main(["release", "build", str(root), "--out", str(tmp_path / "release"), *words]) == 0
    assert check_release(tmp_path / "release", originals=root).exit_code() == 0
    # The recording changes after the build.
    image = next((root / "traversals" / ONLY / "recorded" / "front_wide").glob("*.jpg"))
    image.write_bytes(cv2.imencode(".jpg", np.zeros((72, 128, 3), np.uint8))[1].tobytes())
    found = {one.rule_id for one in check_release(tmp_path / "release", originals=root).findings}
    assert "REL016" in found


def test_a_log_without_the_hash_of_the_source_is_no_proof(dataset: Path, tmp_path: Path) -> None:
    for log in dataset.rglob("redaction/*/log.jsonl"):
        log.write_bytes(encode_log(replace_source(log)))
    words = ["--name", "street", "--licence", "CC0-1.0", "--contact", "a@example.org", "--sample", "0"]
    assert main(["release", "build", str(dataset), "--out", str(tmp_path / "release"), *words]) == 2


def replace_source(log: Path) -> list:
    return [one.model_copy(update={"source_sha256": None}) for one in read_log(log)]


def test_a_release_has_no_hash_of_originals(dataset: Path, tmp_path: Path) -> None:
    release = tmp_path / "release"
    words = ["--name", "street", "--licence", "CC0-1.0", "--contact", "a@example.org", "--sample", "0"]
    assert main(["release", "build", str(dataset), "--out", str(release), *words]) == 0
    sources = {one.source_sha256 for log in dataset.rglob("redaction/*/log.jsonl") for one in read_log(log)}
    assert None not in sources
    text = (release / "redaction_log.jsonl").read_text()
    assert not any(source in text for source in sources)
    lines = [json.loads(line) for line in text.splitlines()]
    lines[0]["source_sha256"] = sorted(sources)[0]
    (release / "redaction_log.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert "REL005" in {one.rule_id for one in check_release(release).findings}


def test_deidentify_continues_after_a_kill_and_leaves_a_valid_index(tmp_path: Path) -> None:
    make_dataset(tmp_path / "dataset", frames=1)
    words = ["deidentify", str(tmp_path / "dataset"), "--detector", "faces", "--detector", "plates"]
    require_resumable(tmp_path / "dataset", [*words, "--plate-region", "XX", "--workers", "1"])
