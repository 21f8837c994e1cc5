"""De-identifying a dataset: what is written, what fails alone, and what an interruption leaves."""

from __future__ import annotations

import hashlib
import signal
from pathlib import Path

import numpy as np
import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.images.decoding import decode_rgb
from mirror.dataset.images.metadata import list_metadata, segments
from mirror.dataset.layout import Layout, read_manifest
from mirror.dataset.redaction import current_redaction
from mirror.errors import DatasetError, UsageError
from mirror.integrity import check
from mirror.privacy.log import read_log
from mirror.privacy.operators import Redaction
from mirror.privacy.regions import covered_share, grown_box
from mirror.privacy.run import deidentify
from mirror.privacy.summary import read_examples, summarize_redactions
from tests.builders.dataset import Builder, write_reconstruction
from tests.interruption import interrupt
from tests.privacy.conftest import FACE, PLATE, make_dataset, options


def tree(root: Path) -> dict[str, str]:
    return {
        path.relative_to(root).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(root.rglob("*"))
        if path.is_file() and ".superseded" not in path.parts
    }


def test_faces_and_plates_are_gone_and_the_recording_stays(deidentified: Path) -> None:
    dataset = mirror.open(str(deidentified))
    assert dataset.count("images") == 18
    for frame in dataset.frames():
        for name, image in frame.images.items():
            assert image.privacy == "redacted"
            data = image.read(verify=True)
            assert list_metadata(data, name) == []
            shown = image.decode().astype(int)
            recorded = deidentified / f"traversals/{frame.traversal_id}/recorded/{name}/{image.timestamp_ns}.jpg"
            original = recorded.read_bytes()
            masks = [mask for mask in image.masks() if mask.kind == "redaction"]
            if name == "rear_left":
                assert not masks
                scans = [[d[s.start : s.end] for s in segments(d, "") if s.marker == 0xDA] for d in (data, original)]
                assert scans[0] == scans[1]
            else:
                mask = masks[0].decode() > 0
                left, top, right, bottom = FACE if name == "front_wide" else PLATE
                assert mask[top:bottom, left:right].all() and mask.mean() < 0.35
                before = decode_rgb(original, "jpeg").astype(float)
                steps = [
                    np.abs(np.diff(one[top:bottom, left:right], axis=1)).mean(axis=(0, 2)) for one in (before, shown)
                ]
                assert (steps[0] > 15.0).mean() > 0.4 and (steps[1] > 15.0).mean() < 0.1
                psnr = 10 * np.log10(255**2 / np.mean((before[~mask] - shown[~mask]) ** 2))
                assert psnr >= 42.0
    rows = dataset.table("images").to_pylist()
    assert all(row["source_sha256"] is not None and row["source_sha256"] != b"" for row in rows)
    assert check(deidentified, cost=2).exit_code() == 0


def test_the_log_has_a_line_an_image(deidentified: Path) -> None:
    layout = Layout(deidentified)
    for traversal_id in mirror.open(str(deidentified)).traversals():
        folder = layout.layer(traversal_id, "redaction", "deidentify", "1")
        records = read_log(folder / "log.jsonl")
        assert len(records) == 9 and "log.jsonl" in read_manifest(folder).files
        for record in records:
            assert [one.name for one in record.detectors] == ["face_marks", "plate_marks"]
            truth = {"front_wide": FACE, "rear": PLATE}.get(record.camera)
            detected = [one for one in record.regions if one.origin == "detector"]
            assert len(detected) == (truth is not None)
            if truth is not None:
                assert covered_share(truth, [detected[0].box_px]) >= 0.9
            data = (folder / record.camera / f"{record.timestamp_ns}.jpg").read_bytes()
            assert hashlib.sha256(data).hexdigest() == record.out_sha256


def test_a_second_run_changes_nothing_and_other_options_need_another_version(dataset: Path) -> None:
    before = tree(dataset)
    for region in ("XX", "xx"):
        report = deidentify(dataset, options(plate_region=region))
        assert (len(report.unchanged), report.written) == (2, []) and tree(dataset) == before
    with pytest.raises(DatasetError, match="derived_from: configuration: "):
        deidentify(dataset, options(redaction=Redaction(grow=0.5)))
    with pytest.raises(DatasetError, match="region of number plates"):
        deidentify(dataset, options("faces", "plates@XX,YY", plate_region="YY"))
    assert tree(dataset) == before
    report = deidentify(dataset, options(redaction=Redaction(grow=0.5), version="2"))
    assert len(report.written) == 2
    assert {row["uri"].split("@")[1][0] for row in mirror.open(str(dataset)).table("images").to_pylist()} == {"2"}


@pytest.mark.parametrize(("detector", "status"), [("crashing", "crashed"), ("hanging", "hung"), ("failing", "failed")])
def test_a_detector_that_fails_on_an_image_fails_there_alone(tmp_path: Path, detector: str, status: str) -> None:
    root = tmp_path / "dataset"
    make_dataset(root, green=True, frames=1)
    only = "a.d0.1700000000000"
    chosen = options(detector, "plates", timeout_s=2.0)
    report = deidentify(root, chosen, traversals=[only])
    assert report.exit_code() == 3 and report.unfinished == [only]
    assert [(one.camera, one.status) for one in report.failures] == [("rear_left", status)]
    assert not list((root / "traversals").glob("*/layers/redaction/*"))
    if detector != "failing":
        return
    report = deidentify(root, options(detector, "plates", withhold_failed=True), traversals=[only])
    assert report.written == [only] and report.images == 2 and report.exit_code() == 3
    # What failed stays raw, and `mirror check` says so.
    assert [row["privacy"] for row in mirror.open(str(root)).where(traversal=only).table("images").to_pylist()] == [
        "redacted",
        "redacted",
        "raw",
    ]
    assert "PRV001" in {rule.rule_id for rule, _ in check(root).findings}


def test_an_unreadable_image_is_named_and_the_others_are_kept(tmp_path: Path) -> None:
    root = tmp_path / "dataset"
    make_dataset(root, frames=1)
    broken = next(root.glob("traversals/a.d0.*/recorded/rear/*.jpg"))
    good = broken.read_bytes()
    broken.write_bytes(b"not an image" + good[12:])
    report = deidentify(root, options())
    assert report.exit_code() == 3
    assert len(report.written) == 1 and len(report.failures) == 1
    assert broken.name in report.failures[0].problem
    broken.write_bytes(good)
    assert deidentify(root, options()).exit_code() == 0
    assert not (root / ".deidentify").exists()


def test_a_run_that_was_killed_is_resumed_to_the_same_bytes(tmp_path: Path, deidentified: Path) -> None:
    root = tmp_path / "dataset"
    make_dataset(root)
    words = ["--detector", "faces", "--detector", "plates", "--plate-region", "XX", "--workers", "2", "--no-cameras"]
    killed = interrupt(
        ["deidentify", root, *words], 0.0, signal.SIGKILL, group=False,
        once=lambda: any(path.stat().st_size for path in root.glob(".deidentify/**/*.jsonl")),
    )  # fmt: skip
    assert killed.code == -signal.SIGKILL
    assert deidentify(root, options()).exit_code() == 0
    layers = {name: value for name, value in tree(root).items() if "/layers/" in name}
    assert layers == {name: value for name, value in tree(deidentified).items() if "/layers/" in name}


def test_without_detectors_of_both_kinds_and_the_region_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "dataset"
    make_dataset(root, frames=1)
    before = tree(root)
    for words, said in (
        (["--detector", "faces", "--plate-region", "XX"], "no plate detector"),
        (["--detector", "plates", "--plate-region", "XX"], "no face detector"),
        (["--detector", "faces", "--detector", "plates"], "not stated"),
        (["--detector", "faces", "--detector", "plates", "--plate-region", "EU"], "covers number plates of EU"),
        (["--detector", "faces", "--detector", "yolo_plates@EU", "--plate-region", "EU"], "no file of weights"),
        (["--detector", "faces", "--detector", "nothing"], "no detector 'nothing'"),
    ):
        assert main(["deidentify", str(root), *words]) == 2
        assert said in capsys.readouterr().err
    assert tree(root) == before
    assert main(["deidentify", str(root), "--list-detectors"]) == 0
    assert "clp_det" in capsys.readouterr().out


def test_derived_layers_of_originals_are_stale(dataset: Path) -> None:
    builder = object.__new__(Builder)
    builder.layout = Layout(dataset)
    opened = mirror.open(str(dataset))
    traversal_id = opened.traversals()[0]
    stamp = opened.where(traversal=traversal_id).table("images", ["timestamp_ns"]).column(0)[0].as_py()
    write_reconstruction(builder, traversal_id, "front_wide", stamp)
    folder = Layout(dataset).layer(traversal_id, "depth", "sweep", "1")
    assert read_manifest(folder).derived_from["redaction"] == current_redaction(Layout(dataset), traversal_id)
    report = check(dataset, only=["PRV"])
    assert report.findings == []
    assert deidentify(dataset, options(version="2", redaction=Redaction(grow=0.5))).exit_code() == 0
    found = [(rule.rule_id, finding.file) for rule, finding in check(dataset, only=["PRV"]).findings]
    assert {name for name, _ in found} == {"PRV002"} and len(found) == 2


def test_a_dataset_without_images_or_an_unknown_traversal(tmp_path: Path) -> None:
    root = tmp_path / "dataset"
    make_dataset(root, frames=1)
    with pytest.raises(UsageError, match="nowhere"):
        deidentify(root, options(), traversals=["nowhere"])
    with pytest.raises(DatasetError, match="the folder does not exist"):
        deidentify(tmp_path / "none", options())


def test_what_was_removed_is_counted_and_drawn(deidentified: Path, tmp_path: Path) -> None:
    dataset = mirror.open(str(deidentified))
    summary = summarize_redactions(dataset)
    assert summary is not None and summary.images == 18
    records = [record for log in deidentified.rglob("redaction/*/log.jsonl") for record in read_log(log)]
    counted: dict[tuple[str, str], int] = {}
    covered = pixels = 0
    for record in records:
        shown = np.zeros((record.height_px, record.width_px), np.bool_)
        for region in record.regions:
            counted[region.kind, region.origin] = counted.get((region.kind, region.origin), 0) + 1
            left, top, right, bottom = grown_box(region, record.grow, record.width_px, record.height_px) or (0, 0, 0, 0)
            shown[top:bottom, left:right] = True
        covered, pixels = covered + int(shown.sum()), pixels + shown.size
    found = {(kind, origin): n for kind, origins in summary.regions.items() for origin, n in origins.items() if n}
    assert found == counted and set(counted) >= {("face", "detector"), ("plate", "detector")}
    assert summary.covered_share == pytest.approx(covered / pixels, rel=1e-12)
    # A view counts its own images only.
    one = summarize_redactions(dataset.where(camera="rear_left"))
    assert (
        one is not None and one.images == 6 and not any(n for counts in one.regions.values() for n in counts.values())
    )
    pytest.importorskip("matplotlib", reason="the extra view is not installed")
    words = ["plot", str(deidentified), "--figure", "privacy", "--format", "svg", "--out", str(tmp_path / "plots")]
    assert main(words) == 0
    assert (tmp_path / "plots" / "privacy.svg").stat().st_size > 1000
    # Before are the recorded pixels, after those that readers get: the stripes of the marks are gone.
    examples = read_examples(dataset)
    assert [one.kind for one in examples] == ["face", "plate", "face", "plate"]
    for one in examples:
        before, after = one.before.astype(float), one.after.astype(float)
        red_or_blue = np.abs(before - ((255, 0, 0) if one.kind == "face" else (0, 0, 255))).max(axis=-1) < 90
        assert before.shape == after.shape and red_or_blue.sum() > 200
        inside = red_or_blue[:, 1:] & red_or_blue[:, :-1]
        stripes, left = (np.abs(np.diff(pixels, axis=1))[inside].mean() for pixels in (before, after))
        assert left < 0.5 * stripes
    raw = tmp_path / "raw"
    make_dataset(raw)
    assert read_examples(mirror.open(str(raw))) == []
    assert summarize_redactions(mirror.open(str(raw))) is None
