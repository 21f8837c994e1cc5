"""Descriptions of frames: what is recorded, programs, interruptions, files that are others."""

from __future__ import annotations

import json
import sys
import textwrap
from collections import Counter
from pathlib import Path

import pytest

import mirror
from mirror.annotation import annotate
from mirror.annotation.descriptions import (
    Description,
    RecordedDescriber,
    describe_frames,
    installed_describer,
    read_descriptions,
)
from mirror.annotation.detections import AnnotationError
from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.dataset.frames import Frame
from mirror.errors import DatasetError, UsageError
from tests.annotation.known import Known
from tests.interruption import interrupting

PROGRAM = textwrap.dedent(
    """
    import json, sys
    for number, line in enumerate(sys.stdin):
        request = json.loads(line)
        assert request["format"] == "mirror-describe/1" and len(request["images"]) == 2
        answer = {"timestamp_ns": request["timestamp_ns"], "text": f"frame {request['frame_index']}"}
        answer["weather"] = "rain" if request["frame_index"] else "frogs"
        print(json.dumps(answer), flush=True)
    """
)


def test_the_default_says_what_is_recorded(tiny_dataset: Dataset) -> None:
    describer = RecordedDescriber(tiny_dataset)
    rows = {row["traversal_id"]: row for row in tiny_dataset.table("traversals").to_pylist()}
    for frame in tiny_dataset.frames():
        said = describer.describe(frame)
        row = rows[frame.traversal_id]
        assert (said.light, said.weather) == (row["light"], row["weather"])
        assert said.text.startswith("An urban street in Guangzhou")
        for name, count in Counter(frame.boxes().category).items():
            assert f"{count} {name}" in said.text


def test_words_that_are_unknown_are_refused() -> None:
    with pytest.raises(AnnotationError, match="light 'noon'"):
        Description("", light="noon")
    with pytest.raises(AnnotationError, match="weather 'frogs'"):
        Description("", weather="frogs")
    with pytest.raises(UsageError, match="no describer 'x' is installed"):
        installed_describer("x")


class Counting:
    """Counts its calls."""

    fingerprint, calls = "counting", 0

    def describe(self, frame: Frame) -> Description:
        self.calls += 1
        return Description(f"{frame.traversal_id} {frame.frame_index}", "day", None)

    def close(self) -> None:
        pass


def test_an_interrupted_run_continues_with_the_same_file(root: Path, tmp_path: Path) -> None:
    dataset, whole, parts = mirror.open(root), tmp_path / "whole", tmp_path / "parts"
    describe_frames(dataset, Counting(), whole)
    with pytest.raises(KeyboardInterrupt):
        describe_frames(dataset, interrupting(Counting(), "describe", 4), parts)
    with parts.open("a") as file:
        file.write('{"traversal_id": "half a li')
    second = Counting()
    report = describe_frames(dataset, second, parts)
    assert (second.calls, report.frames, report.kept) == (4, 4, 3)
    assert parts.read_bytes() == whole.read_bytes()
    found = read_descriptions(whole)
    assert len(found) == len(dataset.frames()) == 7
    assert all(one.text == f"{name} {number}" for (name, number), one in found.items())


def test_files_that_are_others_are_kept(root: Path, tmp_path: Path) -> None:
    dataset, out = mirror.open(root), tmp_path / "out"
    out.write_text("{}\n")
    with pytest.raises(UsageError, match="not a file of descriptions"):
        describe_frames(dataset, Counting(), out)
    assert out.read_text() == "{}\n"
    with pytest.raises(DatasetError, match="not a file of descriptions"):
        read_descriptions(out)
    with pytest.raises(DatasetError, match="no such file"):
        read_descriptions(tmp_path / "absent")
    out.write_text("nonsense\n")
    with pytest.raises(DatasetError, match="broken"):
        read_descriptions(out)


def test_a_program_describes_and_fails_by_frame(root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    program, out = tmp_path / "caption.py", tmp_path / "captions"
    program.write_text(PROGRAM)
    words = ["annotate", "describe", str(root), "--describer", "subprocess", "--out", str(out), "--json"]
    assert main([*words, "--set", f"command={sys.executable} {program}"]) == 3
    report = json.loads(capsys.readouterr().out.splitlines()[-1])
    # The first frame of both traversals has an impossible weather.
    assert (report["frames"], len(report["failed"])) == (5, 2)
    assert all("frogs" in reason for _, _, reason in report["failed"])
    assert {(one.text, one.weather) for one in read_descriptions(out).values()} == {
        (f"frame {number}", "rain") for number in (1, 2, 3)
    }
    assert main(words) == 2
    assert "no command" in capsys.readouterr().err


def test_boxes_of_several_layers_are_not_counted(root: Path) -> None:
    annotate(mirror.open(root), Known())
    one = RecordedDescriber(mirror.open(root)).describe(mirror.open(root).frames()[0])
    assert one.text.endswith("1 car, 1 pedestrian")
    annotate(mirror.open(root), Known(), source="second")
    two = RecordedDescriber(mirror.open(root)).describe(mirror.open(root).frames()[0])
    assert "car" not in two.text
