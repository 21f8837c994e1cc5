"""Attacks by the files of a submission: metadata, side files, timing, caches, tables, archives, names of protocols."""

from __future__ import annotations

import json
import struct
import time
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mirror.arrays import UInt8
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.evaluation.run import Evaluation, EvaluationOptions, evaluate
from mirror.evaluation.submission.check import check_submission
from mirror.evaluation.submission.manifest import MANIFEST, Appearance, SubmittedMethod
from mirror.evaluation.submission.template import expected_files, make_manifest, write_manifest
from mirror.evaluation.submission.untrusted import UntrustedError, open_untrusted
from mirror.protocols.document import load_protocol
from mirror.protocols.views import RenderView, plan_views
from tests.evaluation.submissions import SPLIT, small, small_text, write_renders

PROTOCOL = small(every=10)
ALONE = EvaluationOptions(workers=1)
MANY = 10_000


def noisy(view: RenderView, truth: UInt8) -> UInt8:
    rng = np.random.default_rng(view.frame_index)
    return np.clip(truth + rng.normal(0, 6, truth.shape), 0, 255).astype(np.uint8)


@pytest.fixture
def submission(dataset: Dataset, tmp_path: Path) -> Path:
    write_renders(dataset, PROTOCOL, tmp_path / "s", noisy)
    return tmp_path / "s"


def score(submission: Path, root: Path, out: Path) -> Evaluation:
    return evaluate(submission, root, PROTOCOL, SPLIT, out, ALONE)


def figures(done: Evaluation) -> list[Any]:
    assert done.result is not None, done.check.problems
    return list(done.result.figures)


def with_chunk(png: bytes, kind: bytes, data: bytes) -> bytes:
    """A PNG with another chunk before its pixels."""
    chunk = struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    place = png.index(b"IDAT") - 4
    return png[:place] + chunk + png[place:]


@pytest.mark.parametrize(
    ("kind", "data", "message"),
    [
        (b"eXIf", b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x03\0\0\0", "eXIf"),
        (b"iCCP", b"x\0\0" + zlib.compress(b"profile"), "iCCP"),
        (b"acTL", struct.pack(">II", 2, 0), "acTL"),
        (b"zTXt", b"x\0\0" + zlib.compress(b"0" * 10**6), "zTXt"),
        (b"prVt", b"truth.png", "prVt"),
        (b"gAMA", struct.pack(">I", 100_000), "gamma"),
        (b"tRNS", b"\0\0\0\0\0\0", "tRNS"),
    ],
)
def test_metadata_that_changes_pixels_is_refused(
    submission: Path, root: Path, tmp_path: Path, kind: bytes, data: bytes, message: str
) -> None:
    """An orientation, a colour profile, a second frame, a bomb of text, a private chunk, another gamma, a mask."""
    file = sorted(submission.rglob("*.png"))[0]
    file.write_bytes(with_chunk(file.read_bytes(), kind, data))
    done = score(submission, root, tmp_path / "out")
    assert done.result is None
    assert [problem.kind for problem in done.check.problems] == ["corrupt"]
    assert message in done.check.problems[0].message


def test_allowed_metadata_does_not_reach_the_pixels(submission: Path, root: Path, tmp_path: Path) -> None:
    plain = figures(score(submission, root, tmp_path / "plain"))
    for file in submission.rglob("*.png"):
        png = with_chunk(file.read_bytes(), b"tEXt", b"Comment\0<script>alert(1)</script>")
        png = with_chunk(png, b"sBIT", b"\x01\x01\x01")
        file.write_bytes(with_chunk(png, b"bKGD", struct.pack(">HHH", 255, 255, 255)))
    assert figures(score(submission, root, tmp_path / "marked")) == plain


def test_side_files_of_the_participant_are_never_read(submission: Path, root: Path, tmp_path: Path) -> None:
    """`views.json` with other sizes and poses, masks that score nothing, a README, a table of scores."""
    plain = figures(score(submission, root, tmp_path / "plain"))
    (submission / "views.json").write_text('{"views": [{"path": "../../etc/passwd", "width_px": 1}]}')
    (submission / "README.md").write_text("please give full marks")
    for file in sorted(submission.rglob("*.png")):
        mask = submission / "masks" / file.relative_to(submission / "renders")
        mask.parent.mkdir(parents=True, exist_ok=True)
        mask.write_bytes(b"no image")
    assert figures(score(submission, root, tmp_path / "more")) == plain
    # Any other file is a problem, and nothing is scored.
    (submission / "images.parquet").write_bytes(b"scores")
    done = score(submission, root, tmp_path / "other")
    assert [(problem.kind, problem.path) for problem in done.check.problems] == [("extra", "images.parquet")]


def test_caches_inside_a_submission_are_refused(submission: Path, root: Path, tmp_path: Path) -> None:
    for name in ("work/scored.jsonl", "work/features/0123.npy"):
        (submission / name).parent.mkdir(parents=True, exist_ok=True)
        (submission / name).write_bytes(b"{}")
    done = score(submission, root, tmp_path / "out")
    assert done.result is None
    assert {problem.path for problem in done.check.problems} == {"work/scored.jsonl", "work/features/0123.npy"}


@pytest.mark.parametrize("rate", ["-1", "0", "1e999", "NaN", 'null, "frames_per_second": 9'])
def test_impossible_times_are_refused(submission: Path, root: Path, tmp_path: Path, rate: str) -> None:
    manifest = json.loads((submission / MANIFEST).read_text())
    manifest["runtime"] = {"device": "a GPU", "frames_per_second": 0.125}
    text = json.dumps(manifest)
    assert "0.125" in text
    (submission / MANIFEST).write_text(text.replace("0.125", rate))
    done = score(submission, root, tmp_path / "out")
    assert [problem.kind for problem in done.check.problems] == ["manifest"]


def test_image_that_is_slow_or_broken_is_not_left_out(submission: Path, root: Path, tmp_path: Path) -> None:
    """There is no time limit that drops a view: a view without a score is a problem of the whole submission."""
    worst = sorted(submission.rglob("*.png"))[0]
    data = worst.read_bytes()
    place = data.index(b"IDAT")
    (length,) = struct.unpack(">I", data[place - 4 : place])
    broken = zlib.compress(b"\0" * 10)
    chunk = struct.pack(">I", len(broken)) + b"IDAT" + broken + struct.pack(">I", zlib.crc32(b"IDAT" + broken))
    worst.write_bytes(data[: place - 4] + chunk + data[place + 4 + length + 4 :])
    done = score(submission, root, tmp_path / "out")
    assert done.result is None
    assert [problem.path for problem in done.check.problems] == [worst.relative_to(submission).as_posix()]
    assert not (tmp_path / "out" / "result.json").exists()


def box(score_text: str = "0.5", size: str = "[1, 1, 1]") -> str:
    return f'{{"category": "car", "score": {score_text}, "ego_SE3_box": [1, 0, 0, 0, 0, 0, 0], "size_m": {size}}}'


@pytest.mark.parametrize(
    "boxes",
    [
        box("NaN"),
        box("1e999"),
        box("-0.5"),
        box(size="[1, 1, -1]"),
        box(size="[1, 1, 1e308]"),
        box()[:-1] + ', "score": 0.9}',
        "[" * 2000 + "]" * 2000,
        ", ".join([box()] * 20_000),
    ],
    ids=["nan", "infinite", "negative", "size", "huge", "repeated-key", "deep", "many"],
)
def test_hostile_detections_are_problems(dataset: Dataset, root: Path, tmp_path: Path, boxes: str) -> None:
    protocol = load_protocol("annotation")
    plan = plan_views(dataset, protocol, SPLIT)
    (path,) = expected_files(plan)
    file = tmp_path / "s" / path
    file.parent.mkdir(parents=True, exist_ok=True)
    frames = f'[{{"frame_index": 0, "boxes": [{boxes}]}}]'
    file.write_text(f'{{"format": "mirror-detections", "version": "1.0", "frames": {frames}}}')
    write_manifest(tmp_path / "s", make_manifest(plan, SubmittedMethod(name="boxes"), Appearance(policy="none")))
    done = evaluate(tmp_path / "s", root, protocol, SPLIT, tmp_path / "out", ALONE)
    assert done.result is None
    assert len(done.check.problems) == 1


@pytest.mark.parametrize("zipped", [False, True])
def test_many_extra_files_are_listed_and_never_opened(
    dataset: Dataset, submission: Path, tmp_path: Path, zipped: bool
) -> None:
    """Each extra file is unreadable or a lie; only the expected ones are opened."""
    plan = plan_views(dataset, PROTOCOL, SPLIT)
    if zipped:
        with zipfile.ZipFile(tmp_path / "s.zip", "w") as archive:
            for file in submission.rglob("*"):
                if file.is_file():
                    archive.write(file, file.relative_to(submission))
            for number in range(MANY):
                archive.writestr(f"extra/{number}.png", b"")
    else:
        (submission / "extra").mkdir()
        for number in range(MANY):
            (submission / "extra" / f"{number}.png").touch(mode=0o000)
    begin = time.process_time()
    files = open_untrusted(tmp_path / "s.zip" if zipped else submission)
    opened: list[str] = []
    read = files.read

    def record(path: str, max_bytes: int) -> bytes:
        opened.append(path)
        return read(path, max_bytes)

    files.read = record  # type: ignore[method-assign]
    report = check_submission(files, plan)
    assert report.counts() == {"extra": MANY}
    assert set(opened) == {MANIFEST, *expected_files(plan)}
    # 10^6 files take as many seconds as this takes multiplied by 100: at most five minutes.
    assert time.process_time() - begin < 3.0


def encrypted_zip(submission: Path, out: Path) -> None:
    """A zip whose entries are flagged as encrypted, in the directory and in each entry's own header."""
    with zipfile.ZipFile(out, "w") as archive:
        for file in submission.rglob("*"):
            if file.is_file():
                archive.write(file, file.relative_to(submission))
    data = bytearray(out.read_bytes())
    for mark, flags in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        place = data.find(mark)
        while place >= 0:
            data[place + flags] |= 1
            place = data.find(mark, place + 4)
    out.write_bytes(data)


def test_encrypted_submission_is_refused_and_asks_for_no_password(
    submission: Path, root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    encrypted_zip(submission, tmp_path / "s.zip")
    assert set(open_untrusted(tmp_path / "s.zip").refused.values()) == {"encrypted"}
    assert main(["evaluate", str(root), str(tmp_path / "s.zip"), "--workers", "1"]) == 1
    assert not (tmp_path / "s-results").exists()


@pytest.mark.parametrize("place", ["protocol.toml", "../protocol.toml", "/etc/protocol.toml", "static-reconstruction/"])
def test_protocol_of_the_participant_is_refused(
    submission: Path, root: Path, tmp_path: Path, place: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A manifest that names a protocol by path: only names of shipped protocols are taken from a manifest."""
    for folder in (submission, tmp_path):
        (folder / "protocol.toml").write_text(small_text())
    manifest = json.loads((submission / MANIFEST).read_text())
    (submission / MANIFEST).write_text(json.dumps({**manifest, "protocol": place}))
    assert main(["evaluate", str(root), str(submission), "--workers", "1"]) in (1, 2)
    assert not (tmp_path / "s-results").exists()


def test_folder_that_grows_while_it_is_listed_is_refused(submission: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mirror.evaluation.submission.untrusted.MAX_ENTRIES", 3)
    with pytest.raises(UntrustedError, match="more than 3 files"):
        open_untrusted(submission)
