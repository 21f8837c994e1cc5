"""Recordings that would break the run: each fails by name, the others go on, nobody's text is read as markup."""

from __future__ import annotations

import io
import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from mirror.cli.main import main
from mirror.ingest.rois import write_rois
from mirror.ingest.run import ingest_recordings
from mirror.recordings.registry import open_recording
from tests.builders.folder import SCENE, write_recording
from tests.fuzz.bases import BASES
from tests.fuzz.worker import Request, Worker


def array_header(header: bytes) -> bytes:
    """An ``.npy`` file of version 1 with a given header."""
    padded = header.ljust(118, b" ")[:117] + b"\n"
    return b"\x93NUMPY\x01\x00" + len(padded).to_bytes(2, "little") + padded


def one_segment(root: Path) -> Path:
    """A route of one segment: a route of several would lose only the damaged one."""
    path = BASES["comma2k19"](root).path
    shutil.rmtree(path / "1")
    return path


def flipped_bit(root: Path) -> Path:
    path = one_segment(root)
    file = path / "0" / "global_pose" / "frame_positions"
    # ")" and "+" differ in one bit; the tokenizer never finds the end of the shape.
    file.write_bytes(file.read_bytes().replace(b"), }", b"+, }", 1))
    with pytest.raises(Exception) as caught:
        np.load(io.BytesIO(file.read_bytes()))
    assert type(caught.value).__name__ == "TokenError"
    return path


def claims_too_much(root: Path) -> Path:
    path = one_segment(root)
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (12000000000, 3), }"
    (path / "0" / "global_pose" / "frame_positions").write_bytes(array_header(header) + bytes(240))
    return path


def nested(root: Path) -> Path:
    path = write_recording(root, "nested")
    (path / "calibrations" / "factory.json").write_text("[" * 100_000 + "]" * 100_000)
    return path


def circle(root: Path) -> Path:
    path = write_recording(root, "circle")
    (path / "images" / "rear" / "1.jpg").symlink_to("1.jpg")
    return path


DAMAGED: dict[str, tuple[Callable[[Path], Path], str]] = {
    "TokenError": (flipped_bit, "frame_positions: cannot be read"),
    "MemoryError": (claims_too_much, "frame_positions: cannot be read"),
    "RecursionError": (nested, "factory.json: not valid JSON (nested too deep)"),
    "RuntimeError": (circle, "cannot be followed"),
}


@pytest.mark.parametrize("kind", DAMAGED)
def test_the_others_go_on(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    damage, problem = DAMAGED[kind]
    bad, good = damage(tmp_path / "bad"), write_recording(tmp_path / "good", "good")
    write_rois(tmp_path / "rois.geojson", [SCENE])
    words = ["ingest", str(bad), str(good), "--rois", str(tmp_path / "rois.geojson"), "--out", str(tmp_path / "d")]
    assert main([*words, "--json"]) == 3
    report = json.loads(capsys.readouterr().out)
    assert list(report["drives"]) == ["good"] and len(report["traversals"]) == 1
    (failure,) = report["failures"]
    assert failure["error"] == "RecordingError"
    assert problem in f"{failure['file']}: {failure['problem']}"
    # The same boundary stands in every verb that reads recordings.
    assert main(["rois", "propose", str(bad), str(good), "--min-traversals", "1"]) == (0 if kind in NO_POSES else 3)
    assert main(["info", str(bad)]) == 2
    assert problem in capsys.readouterr().err


NO_POSES = ("RecursionError", "RuntimeError")
"""Damage in files that the poses do not need."""


def doubled(text: str, column: str) -> str:
    """A CSV table with one of its columns twice."""
    lines = [line.split(",") for line in text.splitlines()]
    at = lines[0].index(column)
    return "".join(",".join([*cells, cells[at]]) + "\n" for cells in lines)


@pytest.mark.parametrize(
    ("reader", "file", "column"),
    [
        ("csv", "track.csv", "latitude"),
        ("folder", "poses.csv", "latitude_deg"),
        ("folder", "images/rear.csv", "file"),
        ("boreas", "camera_poses.csv", "easting"),
    ],
)
def test_columns_of_one_name(
    reader: str, file: str, column: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = BASES[reader](tmp_path).path
    (path / file).write_text(doubled((path / file).read_text(), column))
    assert main(["info", str(path)]) == 2
    assert f"column {column}: 2 columns have this name" in capsys.readouterr().err
    if "images" not in file:
        assert main(["rois", "propose", str(path)]) == 2
        assert f"column {column}: 2 columns have this name" in capsys.readouterr().err


def test_text_of_files_is_not_markup(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`[/b]` in a cell ended the report with rich's MarkupError; `[red]` was cut out of the message."""
    first = tmp_path / "first.csv"
    first.write_text("time,longitude,latitude\n[/b],11.5,48.1\n[/b],11.5,48.1\n")
    second = tmp_path / "second.csv"
    second.write_text("[red]when[/red],[bold]lon,:smile:\n1,2,3\n")
    good = write_recording(tmp_path, "good")
    write_rois(tmp_path / "rois.geojson", [SCENE])
    words = [str(first), str(second), str(good), "--rois", str(tmp_path / "rois.geojson")]
    assert main(["ingest", *words, "--out", str(tmp_path / "d")]) == 3
    captured = capsys.readouterr()
    said = captured.out + captured.err
    assert "'[/b]' is not a date and time" in said
    assert "[red]when[/red], [bold]lon, :smile:" in said
    assert "1 traversal, " in said


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    with Worker() as made:
        yield made


@pytest.mark.parametrize("reader", BASES)
@pytest.mark.parametrize("kind", ["out", "device", "pipe", "circle"])
def test_what_is_no_file_of_the_recording_is_refused(reader: str, kind: str, tmp_path: Path, worker: Worker) -> None:
    """In place of each kind of file in turn, in another process: nobody waits for a pipe or reads a device."""
    base = BASES[reader](tmp_path / "fleet")
    # What a reader never opens, such as the lidar of a public dataset, may be anything.
    read = {Path(file).resolve() for _, file in open_recording(base.recording, base.reader).files()}
    files = {
        (file.parent, file.suffix if len(list(file.parent.iterdir())) > 5 else file): file
        for file in base.files
        if file.resolve() in read
    }
    assert files
    (tmp_path / "outside").mkdir()
    for number, file in enumerate(files.values()):
        is_recording = file == base.recording
        if is_recording and kind == "out":
            # A recording in one file may be named by a link.
            continue
        kept = file.read_bytes()
        file.unlink()
        if kind == "out":
            (tmp_path / "outside" / file.name).write_bytes(kept)
            file.symlink_to(tmp_path / "outside" / file.name)
        elif kind == "device":
            file.symlink_to("/dev/zero")
        elif kind == "pipe":
            os.mkfifo(file)
        else:
            file.symlink_to(file.name)
        out = tmp_path / f"d{number}"
        found = worker.ask(Request(base.recording, base.reader, base.roi, out))
        assert len(found.get("failures", ())) == 1, (file, found)
        problem = found["failures"][0]["problem"]
        wanted = {"pipe": ["is no plain file"], "circle": ["cannot be followed"]}.get(kind, ["leads out"])
        if is_recording:
            wanted = ["is no plain file", "there is no file or folder"]
        assert any(words in problem for words in wanted), (file, problem)
        assert not (out / "drives").exists()
        file.unlink()
        file.write_bytes(kept)


def test_a_link_out_is_refused_without_ingesting(tmp_path: Path) -> None:
    base = BASES["boreas"](tmp_path / "fleet")
    (base.path / "camera_poses.csv").rename(tmp_path / "poses.csv")
    (base.path / "camera_poses.csv").symlink_to(tmp_path / "poses.csv")
    report = ingest_recordings([base.path], [base.roi], tmp_path / "d")
    assert "leads out of the recording" in str(report.failures[0][1])
