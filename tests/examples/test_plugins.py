"""The examples, each run in another folder as a user runs them, and plug-ins with faults."""

from __future__ import annotations

import ast
import json
import shutil
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

from mirror.dataset.dataset import Dataset
from mirror.errors import ExitCode
from tests.conftest import ROOT

PLUGINS = ("annotator", "method", "metric", "policy", "reader")


def run(folder: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """Run Python in a folder that has nothing of this repository but copies of the examples."""
    for name in PLUGINS:
        if not (folder / f"{name}.py").exists():
            shutil.copy(ROOT / "examples" / f"{name}.py", folder)
    return subprocess.run(
        [sys.executable, *map(str, words)], cwd=folder, capture_output=True, text=True, check=False, timeout=300
    )


def mirror(folder: Path, *words: object, code: int = ExitCode.DONE) -> str:
    done = run(folder, "-m", "mirror", *words)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout + done.stderr


@pytest.mark.parametrize("name", PLUGINS)
def test_examples_import_public_names_only(name: str) -> None:
    for node in ast.walk(ast.parse((ROOT / "examples" / f"{name}.py").read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(("mirror", "hybridworldsim")):
            assert {alias.name for alias in node.names} <= {*import_module(str(node.module)).__all__}


def test_a_method_and_a_metric_in_a_file_each(tiny_dataset: Dataset, tmp_path: Path) -> None:
    dataset, method = tiny_dataset.root, ("--method", "method.py:METHOD")
    said = mirror(tmp_path, "reconstruct", dataset, "--split", "novel", *method, "--out", "model")
    assert "safetensors" not in said
    document = json.loads((tmp_path / "model" / "reconstruction.json").read_text())
    assert (document["method"], document["done"]["model_bytes"]) == (
        "method.py:METHOD", (tmp_path / "model" / "colours.npz").stat().st_size,
    )  # fmt: skip
    # A document decides on no file that is run.
    refused = mirror(tmp_path, "render", dataset, "model", "--split", "novel", "--out", "no", code=2)
    assert "--method FOLDER/method.py:METHOD" in refused
    mirror(tmp_path, "render", dataset, "model", "--split", "novel", *method, "--out", "submission")
    done = run(tmp_path, "metric.py", dataset, "submission")
    assert done.returncode == 0, done.stderr
    assert all(float(line.split(": ")[1]) > 0.0 for line in done.stdout.splitlines())


def test_a_policy_in_a_file_stays_on_the_road(tmp_path: Path) -> None:
    drive = ("simulate", "synth:tiny", "--scenario", "free-traffic", "--duration", "4", "--no-video", "--width", "64")
    said = json.loads(mirror(tmp_path, *drive, "--policy", "policy.py:Careful", "--out", "rollout", "--json"))
    assert said["ending"] == "duration"
    assert said["safety"]["drivable_margin"] > 0.0


def test_a_fault_of_a_policy_is_named_with_its_file_and_line(tmp_path: Path) -> None:
    text = (ROOT / "examples" / "policy.py").read_text().replace("observation.route[4]", "observation.road[4]")
    (tmp_path / "policy.py").write_text(text)
    line = 1 + text[: text.index("observation.road")].count("\n")
    drive = ("simulate", "synth:tiny", "--scenario", "free-traffic", "--duration", "1", "--no-video", "--width", "64")
    said = mirror(tmp_path, *drive, "--policy", "policy.py:Careful", "--out", "rollout", code=ExitCode.FINDINGS)
    assert f"line {line}, in act" in said and "policy.py" in said and "AttributeError" in said


def test_a_reader_in_a_file(tmp_path: Path) -> None:
    rows = ({"t": 1.7e9 + second, "lon": 11.5763 + 1e-4 * second, "lat": 48.1371} for second in range(30))
    (tmp_path / "drive.walk").write_text("".join(json.dumps(row) + "\n" for row in rows))
    words = ("--reader", "reader.py:WalkReader", "--roi", "11.5778,48.1371")
    mirror(tmp_path, "ingest", "drive.walk", *words, "--out", "dataset")
    assert "guangzhou" not in mirror(tmp_path, "info", "dataset")


def test_an_annotator_in_a_file(tiny_dataset: Dataset, tmp_path: Path) -> None:
    shutil.copytree(tiny_dataset.root, tmp_path / "dataset")
    mirror(tmp_path, "annotate", "dataset", "--annotator", "annotator.py:ANNOTATOR")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("METHOD = 1 / 0\n", "line 1: ZeroDivisionError"),
        ("METHOD = (\n", "line 1: SyntaxError"),
        ("import no_such_package\n", "line 1: ModuleNotFoundError"),
        ("class M:\n    def open(self, *_): ...\n    def reconstruct(self, *_):\n        {}['a']\nMETHOD = M()\n",
         "line 4, in reconstruct: KeyError"),
        ("class M:\n    def open(self, *_): ...\n    def reconstruct(self, *_): ...\nMETHOD = M()\n",
         "reconstruct returned NoneType"),
        ("OTHER = 1\n", "the file has no 'METHOD'; expected one of OTHER"),
        ("METHOD = 1\n", "it has no function reconstruct"),
    ],
)  # fmt: skip
def test_a_fault_of_a_method_is_named_with_its_file_and_line(
    tiny_dataset: Dataset, tmp_path: Path, text: str, named: str
) -> None:
    (tmp_path / "faulty.py").write_text(text)
    words = ("--split", "novel", "--method", "faulty.py:METHOD", "--out", "model")
    said = mirror(tmp_path, "reconstruct", tiny_dataset.root, *words, code=ExitCode.COULD_NOT_RUN)
    assert "faulty.py: " in said or "faulty.py:METHOD" in said
    assert named in said
    assert not (tmp_path / "model").exists()
