"""The command line as a stranger meets it: help, wrong words, wrong input, exit codes, start-up time."""

from __future__ import annotations

import importlib
import json
import statistics
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mirror.cli.main import main
from mirror.cli.verbs import all_commands
from mirror.ingest.rois import write_rois
from mirror.version import __version__
from tests.builders.folder import SCENE, write_recording


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("fleet")
    write_recording(root, "there")
    write_rois(root / "rois.geojson", [SCENE])
    return root


def test_help_lists_every_verb_and_every_verb_has_a_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    for verb, command in all_commands().items():
        assert f"  {verb} " in text
        assert callable(importlib.import_module(command.module).main)
    assert main(["--version"]) == 0
    assert __version__ in capsys.readouterr().out


def test_a_command_without_a_verb_prints_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    assert "usage: mirror VERB" in capsys.readouterr().out


def test_exit_codes_of_ingest(fleet: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    there, rois, out = str(fleet / "there"), str(fleet / "rois.geojson"), str(tmp_path / "d")
    assert main(["ingest", there, "--rois", rois, "--out", out, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["drives"]["there"]["accepted"] == 1
    assert report["images"] == len(list((tmp_path / "d").rglob("*.jpg")))
    assert main(["ingest", there, str(fleet / "none"), "--rois", rois, "--out", out, "--json"]) == 3
    report = json.loads(capsys.readouterr().out)
    assert report["unchanged"] == ["there"]
    assert report["failures"][0]["file"].endswith("none")
    assert main(["ingest", there, "--rois", rois, "--out", out, "--min-duration-s", "3", "--json"]) == 2
    assert "dataset's 10.0" in json.loads(capsys.readouterr().out)["problem"]
    assert main(["index", out]) == 0
    assert (
        main(["rois", "propose", there, "--min-traversals", "1", "--json", "--out", str(tmp_path / "r.geojson")]) == 0
    )
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["proposals"][0]["traversals"] == 1
    assert main(["ingest", there, "--rois", str(tmp_path / "r.geojson"), "--dry-run"]) == 0


@pytest.mark.parametrize(("words", "limit_s"), [(["-c", "import mirror"], 0.3), (["-m", "mirror", "--help"], 0.4)])
def test_start_up_is_quick(words: list[str], limit_s: float) -> None:
    taken = []
    for _ in range(5):
        begin = time.perf_counter()
        subprocess.run([sys.executable, *words], check=True, capture_output=True)
        taken.append(time.perf_counter() - begin)
    assert min(taken) < limit_s, statistics.median(taken)


def test_import_is_light() -> None:
    heavy = ("numpy", "pandas", "pyarrow", "numba", "torch", "cv2", "scipy", "pydantic", "tyro")
    code = f"import sys, mirror; print([name for name in {heavy} if name in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True).stdout == "[]\n"
