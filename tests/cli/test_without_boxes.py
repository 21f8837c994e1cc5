"""Recordings without boxes and masks: every verb says how to go on, and the path walks to its end."""

from __future__ import annotations

import json
import re
import shutil
import sys
from pathlib import Path

import pytest

import mirror
from mirror.cli.main import main
from mirror.dataset.missing import find_missing
from mirror.errors import ExitCode
from mirror.protocols.document import load_protocol, protocol_names, read_definition
from mirror.synth import SynthReport
from tests.conftest import ROOT


@pytest.fixture(scope="module")
def recordings(tiny_recordings: SynthReport, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recordings of the tiny street without their boxes."""
    folder = tmp_path_factory.mktemp("without") / "recordings"
    shutil.copytree(tiny_recordings.recordings[0].parent, folder)
    for path in folder.glob("*/boxes.parquet"):
        path.unlink()
    return folder


def ingest(recordings: Path, out: Path) -> None:
    words = ("ingest", str(recordings), "--rois", str(recordings / "rois.geojson"), "--out", str(out))
    assert main([*words, "--licence", "CC0-1.0"]) == ExitCode.DONE


def test_recordings_without_boxes_are_reconstructed_published_submitted_and_scored(
    recordings: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    ingest(recordings, Path("full"))
    said = capsys.readouterr().out
    for name, verb in (("boxes", "mirror annotate"), ("points", "mirror depth"), ("masks", "mirror annotate masks")):
        assert re.search(rf"^no {name}: 2 of 2 traversals; needed by .*`{verb}`", said, re.M), said
    assert "--no-masks" in said and "no lens" not in said

    def run(words: str) -> int:
        return main(words.split())

    assert run("split full novel --train 1 --held-out-traversals 1") == ExitCode.DONE
    train = "reconstruct full --split novel --width 64 --steps 4 --threads 1 --out model"
    for words in (train, "dataset publish full --split novel --out published"):
        capsys.readouterr()
        assert run(words) == ExitCode.COULD_NOT_RUN
        assert "--protocol static-reconstruction-unmasked" in capsys.readouterr().err
    for words in (
        f"{train} --no-masks",
        "dataset publish full --split novel --no-masks --out published",
        "dataset fetch published --out street",
        "submission new street --protocol static-reconstruction --no-masks --split novel --out template",
        "render street model --split novel --no-masks --out submission",
        "submission check street submission",
        "evaluate full submission --workers 1 --out scores",
    ):
        assert run(words) == ExitCode.DONE, words
    result = json.loads(Path("scores/result.json").read_text())
    assert result["protocol"]["name"] == "static-reconstruction-unmasked"
    assert {"training", "novel"} == {figure["group"] for figure in result["figures"]}


def test_a_program_of_ten_lines_brings_boxes(recordings: Path, tmp_path: Path) -> None:
    """The program of docs/annotation/detectors.md, with a detector that finds one box in every image."""
    page = (ROOT / "docs" / "annotation" / "detectors.md").read_text()
    (code,) = re.findall(r"```python\n(# detect.py\n.*?)```", page, re.S)
    assert len([line for line in code.splitlines() if line.strip()]) <= 10
    box = '[{"centre_m": [8, 2, 0.8], "rotation": [1, 0, 0, 0], "size_m": [4.2, 1.8, 1.5], "category": "car"}]'
    (tmp_path / "detect.py").write_text(code.replace("return []", f"return {box}"))
    dataset = tmp_path / "dataset"
    ingest(recordings, dataset)
    assert {one.name for one in find_missing(mirror.open(dataset))} == {"boxes", "masks", "points"}
    program = f"command={sys.executable} {tmp_path / 'detect.py'}"
    assert main(["annotate", str(dataset), "--annotator", "subprocess", "--set", program]) == ExitCode.DONE
    assert mirror.open(dataset).count("boxes") == mirror.open(dataset).count("images")
    assert {one.name for one in find_missing(mirror.open(dataset))} == {"points"}


def test_a_camera_without_a_lens_is_named_at_ingest(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / "recordings"
    shutil.copytree(recordings, copy)
    for path in copy.glob("*/calibrations/*"):
        path.unlink()
    ingest(copy, tmp_path / "dataset")
    said = capsys.readouterr().out
    assert "no lens: camera front_left, " in said and "`mirror calibrate intrinsics`" in said


def test_protocols_are_listed_and_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["protocols", "list", "--json"]) == ExitCode.DONE
    assert [row["name"] for row in json.loads(capsys.readouterr().out)] == protocol_names()
    assert main(["protocols", "list"]) == ExitCode.DONE
    assert len(capsys.readouterr().out.splitlines()) == len(protocol_names())
    for name in protocol_names():
        assert main(["protocols", "show", name]) == ExitCode.DONE
        (tmp_path / "mine.toml").write_text(capsys.readouterr().out)
        assert load_protocol(str(tmp_path / "mine.toml")) == load_protocol(name)
        assert main(["protocols", "show", str(tmp_path / "mine.toml")]) == ExitCode.DONE
        assert capsys.readouterr().out == (tmp_path / "mine.toml").read_text()
    (tmp_path / "mine.toml").write_text(read_definition("lane-shift").decode().replace('"psnr"', '"psnrr"'))
    assert main(["protocols", "show", str(tmp_path / "mine.toml")]) == ExitCode.COULD_NOT_RUN
    assert "metric 'psnrr' is none of psnr, " in capsys.readouterr().err
    assert main(["protocols", "show", "static"]) == ExitCode.COULD_NOT_RUN
    assert "static-reconstruction" in capsys.readouterr().err
