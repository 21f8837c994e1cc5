"""Annotating a small dataset: from files, by programs, with failures, interruptions and layers that exist."""

from __future__ import annotations

import json
import resource
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

import mirror
from mirror.annotation import Detections, annotate, installed_annotator, read_box_layer
from mirror.annotation.detections import AnnotationError
from mirror.annotation.nuscenes import sample_token
from mirror.annotation.tracking.layer import track_layer
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.dataset.index.build import build_index
from mirror.errors import DatasetError, UsageError
from tests.annotation.known import Known, truth
from tests.builders.dataset import Builder, Pass
from tests.interruption import interrupt_before, interrupting


def assert_truth(dataset: Dataset, layer: str) -> None:
    for frame in dataset.with_layers(boxes=layer).frames():
        expected, found = truth(frame), frame.boxes()
        order = np.argsort(list(found.category))
        np.testing.assert_allclose(found.pose.translation[order], expected.ego_SE3_box.translation, atol=1e-9)
        np.testing.assert_allclose(found.size_m[order], expected.size_m, atol=1e-12)
        np.testing.assert_allclose(found.velocity_mps[order], expected.velocity_mps, atol=1e-9)
        np.testing.assert_allclose(found.score[order], expected.score)
        cosine = np.abs(np.sum(found.pose.rotation[order] * expected.ego_SE3_box.rotation, axis=1))
        np.testing.assert_allclose(cosine, 1.0, atol=1e-12)


def test_a_layer_is_written_once_and_read_back(root: Path) -> None:
    report = annotate(mirror.open(root), Known())
    assert (len(report.written), report.frames, report.boxes, report.failed) == (2, 7, 14, [])
    assert_truth(mirror.open(root), "known@1")
    frames = read_box_layer(mirror.open(root), "known@1")
    assert sorted(map(len, frames.values())) == [3, 4]
    again = annotate(mirror.open(root), Known())
    assert (again.written, len(again.kept), again.frames) == ([], 2, 0)
    # No layer is replaced: another annotator must take another version.
    other = Known()
    other.fingerprint = "other"
    with pytest.raises(DatasetError, match="derived_from: annotator: "):
        annotate(mirror.open(root), other)
    assert len(annotate(mirror.open(root), other, version="2").written) == 2
    assert not (root / ".annotate").exists() or not any((root / ".annotate").iterdir())


def test_failed_frames_and_interruptions_lose_nothing(root: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        annotate(mirror.open(root), interrupting(Known(), "annotate", 6))
    failing = Known(failing=(2,))
    report = annotate(mirror.open(root), failing)
    # d0 was finished before; of d1, one frame was.
    assert (len(report.kept), report.resumed, len(report.failed)) == (1, 1, 1)
    assert report.incomplete == [failed.traversal_id for failed in report.failed]
    assert "no result" in report.failed[0].reason
    last = Known()
    report = annotate(mirror.open(root), last)
    assert (last.calls, report.resumed, report.failed) == (1, 2, [])
    assert_truth(mirror.open(root), "known@1")


def test_a_full_disk_ends_the_run_by_the_name_of_the_file_and_the_next_run_continues(root: Path) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)

    class FullDisk(Known):
        """Leaves no room for all of the second frame."""

        def annotate(self, frame: Frame) -> Detections:
            if self.calls == 1:
                (journal,) = (root / ".annotate").glob("*/*.jsonl")
                resource.setrlimit(resource.RLIMIT_FSIZE, (journal.stat().st_size + 9, limits[1]))
            return super().annotate(frame)

    full = FullDisk()
    try:
        with pytest.raises(DatasetError, match="cannot be written: File too large") as error:
            annotate(mirror.open(root), full)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert full.calls == 2 and str(error.value.file).endswith(".jsonl")
    assert "run the same command again" in str(error.value.remedy)
    last = Known()
    report = annotate(mirror.open(root), last)
    assert (last.calls, report.resumed, len(report.written), report.failed) == (6, 1, 2, [])
    assert_truth(mirror.open(root), "known@1")


def test_failed_frames_can_be_skipped(root: Path) -> None:
    report = annotate(mirror.open(root), Known(failing=(1,)), skip_failed=True)
    assert (len(report.written), len(report.failed), report.boxes) == (2, 2, 10)


def test_results_of_a_file_come_back_as_exported(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    annotate(mirror.open(root), Known())
    file = tmp_path / "review.json"
    assert main(["annotate", "export", str(root), "--out", str(file)]) == 0
    document = json.loads(file.read_text())
    box = next(iter(document["results"].values()))[0]
    assert set(box) >= {
        "sample_token",
        "translation",
        "size",
        "rotation",
        "velocity",
        "detection_name",
        "detection_score",
    }
    words = ["annotate", str(root), "--annotator", "file", "--set", f"path={file}", "--source", "review", "--json"]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["boxes"] == 14
    assert_truth(mirror.open(root), "review@1")
    # One frame is missing, one box is invalid: both are named, and nothing is written for their traversals.
    tokens = list(document["results"])
    del document["results"][tokens[0]]
    document["results"][tokens[-1]][0]["size"][1] = float("nan")
    file.write_text(json.dumps(document))
    assert main([*words[:-3], "--source", "broken", "--json"]) == 3
    failed = json.loads(capsys.readouterr().out.splitlines()[-1])["failed"]
    assert [tokens[0] in failed[0]["reason"], "size_m" in failed[1]["reason"]] == [True, True]


def test_a_traversal_without_images_has_layers_without_boxes(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    builder = Builder(root, cameras=("front_wide", "rear"))
    builder.scene("a")
    builder.drive("poses-only", [Pass("a", frames=0, heading_deg=90.0)])
    build_index(root)
    annotate(mirror.open(root), Known())
    file = tmp_path / "review.json"
    assert main(["annotate", "track", str(root), "--min-boxes", "2", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert len(report["written"]) == 3 and report["tracks"] == 4
    assert main(["annotate", "masks", str(root), "--boxes", "known-tracks@1", "--json"]) == 0
    assert main(["annotate", "export", str(root), "--boxes", "known-tracks@1", "--out", str(file)]) == 0
    assert len(json.loads(file.read_text())["results"]) == 7


def test_interrupted_tracking_continues(root: Path) -> None:
    annotate(mirror.open(root), Known())
    with interrupt_before("layers/*/*", 2):
        track_layer(mirror.open(root))
    report = track_layer(mirror.open(root), "known@1")
    assert (len(report.kept), len(report.written)) == (1, 1)


def test_frames_too_far_apart_for_tracks_are_explained(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    annotate(mirror.open(root), Known())
    assert main(["annotate", "track", str(root), "--max-gap-s", "0.01", "--min-boxes", "2"]) == 0
    out = capsys.readouterr().out
    assert "became 0 tracks" in out and "at most 0.01 s apart (--max-gap-s)" in out


def test_files_that_are_no_results_are_refused(root: Path, tmp_path: Path) -> None:
    dataset = mirror.open(root)
    opener = installed_annotator("file")
    file = tmp_path / "results.json"
    for text, message in (
        ("{", "not JSON"),
        ("[]", "no object"),
        ('{"results": {"a": 1}}', "not a list"),
        ('{"results": {"elsewhere.1": []}}', "none of its 1 samples"),
    ):
        file.write_text(text)
        with pytest.raises(UsageError, match=message):
            opener.open(dataset, {"path": str(file)}, "cpu")
    with pytest.raises(UsageError, match="cannot be read"):
        opener.open(dataset, {"path": str(tmp_path / "absent")}, "cpu")
    with pytest.raises(UsageError, match="no setting"):
        opener.open(dataset, {"pth": "x"}, "cpu")
    with pytest.raises(UsageError, match="no annotator"):
        installed_annotator("absent")


PROGRAM = """
import json, pathlib, sys, time
state = pathlib.Path(sys.argv[1])
mode = sys.argv[2]
for line in sys.stdin:
    request = json.loads(line)
    assert all(pathlib.Path(image["path"]).stat().st_size > 100 for image in request["images"])
    assert request["images"][0]["calibration"]["model"] == "pinhole"
    key = (request["traversal_id"], request["frame_index"])
    if mode == "crash" and key[1] == 1 and not state.exists():
        state.write_text("crashed")
        sys.exit(3)
    if mode == "hang" and key[1] == 1:
        time.sleep(60)
    while mode == "endless":
        sys.stdout.write("x" * 65536)
    if mode == "noise":
        print("loading ...", flush=True)
    box = {"centre_m": [8.0, 2.0, 0.8], "rotation": [1, 0, 0, 0], "size_m": [4, 2, 1.5]}
    box |= {"category": "car", "score": 0.5}
    if mode == "nan" and key[1] == 1:
        box["centre_m"][0] = float("nan")
    print(json.dumps({"timestamp_ns": request["timestamp_ns"], "boxes": [box]}), flush=True)
"""


def run_program(root: Path, tmp_path: Path, mode: str, limit_s: float = 20.0) -> tuple[mirror.Dataset, object, object]:
    program = tmp_path / "detect.py"
    program.write_text(textwrap.dedent(PROGRAM))
    settings = {"command": f"{sys.executable} {program} {tmp_path / mode} {mode}", "limit_s": str(limit_s)}
    annotator = installed_annotator("subprocess").open(mirror.open(root), settings, "cpu")
    try:
        report = annotate(mirror.open(root), annotator)
    finally:
        annotator.close()
    return mirror.open(root), report, annotator


def test_a_program_that_crashes_is_started_again(root: Path, tmp_path: Path) -> None:
    dataset, report, annotator = run_program(root, tmp_path, "crash")
    assert (report.failed, report.boxes, annotator.restarts) == ([], 7, 1)  # type: ignore[attr-defined]
    assert dataset.count("boxes") == 7


@pytest.mark.parametrize(
    ("mode", "limit_s", "message"),
    [
        ("hang", 0.6, "no answer within"),
        ("noise", 20.0, "not JSON"),
        ("nan", 20.0, "centre_m"),
        ("endless", 60.0, "has no end after 16 MiB"),
    ],
)
def test_a_program_that_hangs_or_talks_nonsense_fails_by_frame(
    root: Path, tmp_path: Path, mode: str, limit_s: float, message: str
) -> None:
    _, report, _ = run_program(root, tmp_path, mode, limit_s)
    assert report.failed  # type: ignore[attr-defined]
    assert all(message in failed.reason for failed in report.failed)  # type: ignore[attr-defined]


def test_a_program_that_is_absent_is_named(root: Path) -> None:
    settings = {"command": "/no/such/program"}
    report = annotate(mirror.open(root), installed_annotator("subprocess").open(mirror.open(root), settings, "cpu"))
    assert "/no/such/program" in report.failed[0].reason
    for settings, message in (({}, "no command"), ({"command": "x", "limit_s": "-1"}, "limit_s")):
        with pytest.raises(UsageError, match=message):
            installed_annotator("subprocess").open(mirror.open(root), settings, "cpu")


def test_tracks_become_a_layer_beside_the_boxes(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    annotate(mirror.open(root), Known())
    words = ["annotate", "track", str(root), "--boxes", "known@1", "--json"]
    assert main(words) == 0
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (report["layer"], len(report["written"]), report["detections"]) == ("known-tracks@1", 2, 14)
    assert report["tracks"] == 4
    view = mirror.open(root).with_layers(boxes="known-tracks@1")
    frames = list(view.frames())
    assert [len(frame.boxes()) for frame in frames] == [2] * 7
    assert len({name for frame in frames[:4] for name in frame.boxes().track_id}) == 2
    # Tracking again keeps the layer; other options need another version.
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["kept"] == report["written"]
    assert main([*words, "--gate-m", "2"]) == 2


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"size_m": np.array([[4.0, 0.0, 1.0]])}, "size_m"),
        ({"score": np.array([1.5])}, "score"),
        ({"velocity_mps": np.array([[np.inf, 0.0, 0.0]])}, "velocity_mps"),
        ({"category": ("",)}, "category"),
        ({"category": ("a", "b")}, "2 categories"),
        ({"size_m": np.ones((2, 3))}, "shape"),
        ({"centre_m": np.array([[np.nan, 0.0, 0.0]])}, "centre_m"),
        ({"rotation": np.zeros((1, 4))}, "rotation"),
    ],
)
def test_invalid_boxes_are_named(changes: dict[str, object], message: str) -> None:
    arguments: dict[str, object] = {
        "centre_m": np.zeros((1, 3)), "rotation": np.array([[1.0, 0.0, 0.0, 0.0]]), "size_m": np.ones((1, 3)),
        "velocity_mps": np.zeros((1, 3)), "category": ("car",), "score": np.array([0.5]),
    }  # fmt: skip
    with pytest.raises(AnnotationError, match=message):
        Detections.from_arrays(0, **(arguments | changes))  # type: ignore[arg-type]


def test_tokens_name_traversal_and_time() -> None:
    assert sample_token("a.d0.17", 5) == "a.d0.17.5"
