"""The examples, each run in another folder as a user runs it, and plug-ins with faults."""

from __future__ import annotations

import ast
import json
import shutil
import subprocess
import sys
from collections.abc import Callable
from hashlib import sha256
from importlib import import_module
from pathlib import Path

import gymnasium
import numpy as np
import pytest

from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.errors import ExitCode
from mirror.methods.hosting import describe_task
from mirror.methods.plugin import ReconstructionTask
from mirror.protocols.document import load_protocol
from mirror.schema.files import write_json
from tests.conftest import ROOT

PLUGINS = ("annotator", "method", "metric", "policy", "reader")


def copy_examples(folder: Path) -> None:
    """Copy the examples to a folder, but for those that it has."""
    for name in PLUGINS:
        if not (folder / f"{name}.py").exists():
            shutil.copy(ROOT / "examples" / f"{name}.py", folder)


def run(folder: Path, *words: object) -> subprocess.CompletedProcess[str]:
    """Run Python in a folder that has nothing of this repository but copies of the examples."""
    copy_examples(folder)
    return subprocess.run(
        [sys.executable, *map(str, words)], cwd=folder, capture_output=True, text=True, check=False, timeout=300
    )


def mirror(folder: Path, *words: object, code: int = ExitCode.DONE) -> str:
    """Run `mirror` in a process of its own and return what it prints."""
    done = run(folder, "-m", "mirror", *words)
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout + done.stderr


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run `mirror` in this process, in the test's folder with copies of the examples; returns what it prints."""
    monkeypatch.chdir(tmp_path)

    def run_here(*words: object, code: int = ExitCode.DONE) -> str:
        copy_examples(tmp_path)
        done = main([*map(str, words)])
        said = capsys.readouterr()
        assert done == code, said.err
        assert "Traceback" not in said.err
        return said.out + said.err

    return run_here


@pytest.mark.parametrize("name", PLUGINS)
def test_examples_import_public_names_only(name: str) -> None:
    for node in ast.walk(ast.parse((ROOT / "examples" / f"{name}.py").read_text())):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(("mirror", "hybridworldsim")):
            assert {alias.name for alias in node.names} <= {*import_module(str(node.module)).__all__}


def test_a_method_and_a_metric_in_a_file_each(tiny_dataset: Dataset, tmp_path: Path, here: Callable[..., str]) -> None:
    dataset, method = tiny_dataset.root, ("--method", "method.py:METHOD")
    said = mirror(tmp_path, "reconstruct", dataset, "--split", "novel", *method, "--out", "model")
    assert "safetensors" not in said
    # A method that counts neither steps nor decibels leaves no gap in the sentence.
    assert f"{tiny_dataset.scenes()[0]}: reconstructed, " in said
    document = json.loads((tmp_path / "model" / "reconstruction.json").read_text())
    assert (document["method"], document["done"]["model_bytes"]) == (
        "method.py:METHOD", (tmp_path / "model" / "colours.npz").stat().st_size,
    )  # fmt: skip
    # A document decides on no file that is run.
    refused = here("render", dataset, "model", "--split", "novel", "--out", "no", code=2)
    assert "--method FOLDER/method.py:METHOD" in refused
    here("render", dataset, "model", "--split", "novel", *method, "--out", "submission")
    done = run(tmp_path, "metric.py", dataset, "submission")
    assert done.returncode == 0, done.stderr
    assert all(float(line.split(": ")[1]) > 0.0 for line in done.stdout.splitlines())


EXPORTING = """
class Exporting(MeanColour):
    capabilities = Capabilities(renders_depth=True, exports_ply=True)

    def export_ply(self, model, views, out, options, appearance):
        from mirror.methods.ply_export import PlyExport

        out.write_bytes(b"ply of " + views[0].camera.encode())
        return PlyExport(gaussians=0, bytes=out.stat().st_size, psnr_db=1.0, origin_m=(0.0, 0.0, 0.0))


METHOD = Exporting()
"""


def test_a_model_of_a_method_in_a_file_is_opened_by_every_verb(
    tiny_dataset: Dataset, tmp_path: Path, here: Callable[..., str]
) -> None:
    dataset, method = tiny_dataset.root, ("--method", "method.py:METHOD")
    (tmp_path / "method.py").write_text((ROOT / "examples" / "method.py").read_text() + EXPORTING)
    here("reconstruct", dataset, "--split", "novel", *method, "--out", "model")
    here("view", dataset, "model", "--measure", "1", *method)
    here("export-ply", dataset, "model", "--out", "street.ply", *method)
    drive = ("--scenario", "free-traffic", "--policy", "policy.py:Careful", "--duration", "0.2", "--width", "32")
    here("simulate", dataset, "model", *drive, "--no-video", "--out", "rollout", *method)
    env = gymnasium.make(
        "hybridworldsim.gym:mirror/Street-v0", street=dataset, model="model", method="method.py:METHOD",
        cameras=("front_wide",), width_px=32,
    )  # fmt: skip
    seen, _ = env.reset()
    with np.load(tmp_path / "model" / "colours.npz") as colours:
        expected = np.floor(colours["front_wide"])
    # The environment's sky is the method's colour: its model was opened by the file, and rendered.
    assert seen["cameras"]["front_wide"][0, 0].tolist() == pytest.approx(expected, abs=1)
    assert (tmp_path / "street.ply").read_bytes().startswith(b"ply of ")
    # The rollout states which model it shows, though that has no safetensors.
    assert json.loads((tmp_path / "rollout" / "run.json").read_text())["model_hash"] != sha256(b"").hexdigest()
    serve = (sys.executable, "-m", "mirror", "serve", dataset, "model", "--port", "0", *method)
    with subprocess.Popen([*map(str, serve)], cwd=tmp_path, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            lines = [server.stdout.readline() for _ in range(2)]
            assert lines[0].startswith("device: cpu") and "SensorsimService at 127.0.0.1:" in lines[1]
        finally:
            server.terminate()


@pytest.mark.parametrize(
    "words",
    [
        ("view", "{dataset}", "{model}"),
        ("export-ply", "{dataset}", "{model}", "--out", "{model}.ply"),
        ("render", "{dataset}", "{model}", "--split", "novel", "--out", "{model}-out"),
    ],
)
def test_the_document_of_a_model_decides_on_no_file_that_is_run(
    tiny_dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: tuple[str, ...]
) -> None:
    task = ReconstructionTask(tiny_dataset.scenes()[0], "novel", load_protocol("static-reconstruction"))
    (tmp_path / "model").mkdir()
    write_json(tmp_path / "model" / "reconstruction.json", describe_task("method.py:METHOD", tiny_dataset, task))
    (tmp_path / "method.py").write_text("raise SystemExit('it ran')")
    given = [word.format(dataset=tiny_dataset.root, model=tmp_path / "model") for word in words]
    for named, said in (((), "add --method FOLDER/method.py:METHOD"), (("--method", "other.py:M"), "other.py:M")):
        assert main([*given, *named]) == ExitCode.COULD_NOT_RUN
        assert said in capsys.readouterr().err


def test_a_policy_in_a_file_stays_on_the_road(here: Callable[..., str]) -> None:
    drive = ("simulate", "synth:tiny", "--scenario", "free-traffic", "--duration", "4", "--no-video", "--width", "64")
    said = json.loads(here(*drive, "--policy", "policy.py:Careful", "--out", "rollout", "--json"))
    assert said["ending"] == "duration"
    assert said["safety"]["drivable_margin"] > 0.0


def test_a_fault_of_a_policy_is_named_with_its_file_and_line(tmp_path: Path, here: Callable[..., str]) -> None:
    text = (ROOT / "examples" / "policy.py").read_text().replace("observation.route[4]", "observation.road[4]")
    (tmp_path / "policy.py").write_text(text)
    line = 1 + text[: text.index("observation.road")].count("\n")
    drive = ("simulate", "synth:tiny", "--scenario", "free-traffic", "--duration", "1", "--no-video", "--width", "64")
    said = here(*drive, "--policy", "policy.py:Careful", "--out", "rollout", code=ExitCode.FINDINGS)
    assert said.startswith("rollout: the policy failed after 0 steps\n")
    assert f"line {line}, in act" in said and "policy.py" in said and "AttributeError" in said


def test_a_reader_in_a_file(tmp_path: Path, here: Callable[..., str]) -> None:
    rows = ({"t": 1.7e9 + second, "lon": 11.5763 + 1e-4 * second, "lat": 48.1371} for second in range(30))
    (tmp_path / "drive.walk").write_text("".join(json.dumps(row) + "\n" for row in rows))
    words = ("--reader", "reader.py:WalkReader", "--roi", "11.5778,48.1371")
    mirror(tmp_path, "ingest", "drive.walk", *words, "--out", "dataset")
    assert "guangzhou" not in here("info", "dataset")


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
        ("METHOD = 1\n", "it has no open, reconstruct"),
    ],
)  # fmt: skip
def test_a_fault_of_a_method_is_named_with_its_file_and_line(
    tiny_dataset: Dataset, tmp_path: Path, here: Callable[..., str], text: str, named: str
) -> None:
    (tmp_path / "faulty.py").write_text(text)
    words = ("--split", "novel", "--method", "faulty.py:METHOD", "--out", "model")
    said = here("reconstruct", tiny_dataset.root, *words, code=ExitCode.COULD_NOT_RUN)
    assert "faulty.py: " in said or "faulty.py:METHOD" in said
    assert named in said
    assert not (tmp_path / "model").exists()
