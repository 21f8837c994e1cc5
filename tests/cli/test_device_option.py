"""`--device` of the verbs: the first line says which and why, and a GPU that cannot be used is refused at once."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.devices import Device
from mirror.errors import ExitCode
from mirror.methods.model import ModelFolder
from mirror.methods.model_document import DOCUMENT
from tests.command_help import help_of
from tests.conftest import ROOT

EXAMPLE = f"{ROOT / 'examples' / 'method.py'}:METHOD"
VERBS = (
    "reconstruct", "render", "view", "evaluate", "annotate", "annotate describe", "depth", "simulate", "serve",
    "generate clips", "generate train", "generate distil", "generate scene",
)  # fmt: skip
PLACED = """

class Placed(MeanColour):
    capabilities = Capabilities(renders_depth=True, takes_device=True, rasterizes=True)
    devices = []
    budgets = []

    def reconstruct(self, dataset, task, out, progress):
        self.devices.append(task.device)
        self.budgets.append((task.protocol.pixels.max_width_px, task.steps, task.core_minutes))
        return super().reconstruct(dataset, task, out, progress)

    def open(self, model, appearance=None, *, device="cpu"):
        self.devices.append(device)
        return super().open(model, appearance)


METHOD = Placed()
"""
no_gpu = pytest.mark.skipif(torch.cuda.is_available(), reason="this machine has a GPU")


@pytest.mark.parametrize("verb", VERBS)
def test_every_verb_that_computes_takes_a_device(verb: str) -> None:
    assert "--device {auto|cpu|cuda[:N]}" in help_of(verb) or "--device auto|cpu|cuda[:N]" in help_of(verb)


def test_the_first_line_says_which_device_and_why(
    tiny_dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data, model, submission = str(tiny_dataset.root), str(tmp_path / "model"), str(tmp_path / "submission")
    method = ("--method", EXAMPLE)
    for words, reason in (
        (["reconstruct", data, "--split", "novel", "--out", model, *method], "method method.py:METHOD takes no device"),
        (["render", data, model, "--split", "novel", "--out", submission, *method, "--device", "cpu"], "--device cpu"),
        (["evaluate", data, submission, "--out", str(tmp_path / "scores"), "--workers", "1"], "--device cpu"),
    ):
        assert main(words) == ExitCode.DONE
        lines = capsys.readouterr().out.splitlines()
        assert lines[0] == f"device: cpu ({reason})"
        if words[0] == "reconstruct":
            assert lines[1] == "defaults on this device: --width 240 --minutes 10"
    for words in (
        ["reconstruct", data, "--split", "novel", "--out", str(tmp_path / "a"), *method],
        ["render", data, model, "--split", "novel", "--out", str(tmp_path / "a"), *method],
        ["annotate", data, "--annotator", "file"],
    ):
        assert main([*words, "--device", "cuda"]) == ExitCode.COULD_NOT_RUN
        assert "takes no device" in capsys.readouterr().err and not (tmp_path / "a").exists()


@no_gpu
@pytest.mark.parametrize(
    "words",
    [
        ["evaluate", "{data}", "{data}", "--out", "{out}"],
        ["annotate", "{data}", "--annotator", "petr-tiny", "--version", "1"],
        ["depth", "{data}", "--split", "novel", "--method", "mvsnet"],
        ["generate", "train", "{data}", "--steps", "1", "--out", "{out}"],
        ["generate", "scene", "{data}", "{data}", "--background", "exact:tiny", "--out", "{out}"],
    ],
    ids=lambda words: " ".join(words[:2]),
)
def test_a_gpu_that_cannot_be_used_is_refused_before_anything_is_made(
    tiny_dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    given = [word.format(data=tiny_dataset.root, out=tmp_path / "out") for word in words]
    assert main([*given, "--device", "cuda:1"]) == ExitCode.COULD_NOT_RUN
    said = capsys.readouterr().err
    assert "--device" in said and ("built for the CPU" in said or "no GPU" in said) and "--device cpu" in said
    assert not (tmp_path / "out").exists()


def test_a_device_without_a_model_is_refused(tiny_dataset: Dataset, capsys: pytest.CaptureFixture[str]) -> None:
    for words in (["view", str(tiny_dataset.root)], ["serve", "synth:tiny"]):
        assert main([*words, "--device", "cpu"]) == ExitCode.COULD_NOT_RUN
        assert "--device: cpu; expected none without MODEL" in capsys.readouterr().err


def test_a_method_that_states_it_gets_the_device(tiny_dataset: Dataset, tmp_path: Path) -> None:
    (tmp_path / "placed.py").write_text((ROOT / "examples" / "method.py").read_text() + PLACED)
    method = f"{tmp_path / 'placed.py'}:METHOD"
    words = ["reconstruct", str(tiny_dataset.root), "--split", "novel", "--out", str(tmp_path / "model")]
    assert main([*words, "--method", method, "--device", "cpu", "--json"]) == ExitCode.DONE
    assert (tmp_path / "model" / DOCUMENT).is_file()
    model = ModelFolder.read(tmp_path / "model", method)
    model.open(device="cuda:7")
    model.open_interactive([], device="cuda:7")
    model.open()
    assert model.method.devices[-3:] == ["cuda:7", "cuda:7", "cpu"]  # type: ignore[attr-defined]
    assert model.choose_device("cpu").name == "cpu"


@pytest.mark.parametrize(
    ("device", "given", "expected", "line"),
    [
        ("cuda:0", [], (960, 30_000, None), "defaults on this device: --width 960 --steps 30000"),
        ("cuda:0", ["--width", "480"], (480, 30_000, None), "defaults on this device: --steps 30000"),
        ("cuda:0", ["--minutes", "2"], (960, None, 2.0), "defaults on this device: --width 960"),
        ("cpu", ["--steps", "7", "--width", "96"], (96, 7, None), None),
        ("cpu", [], (240, None, 10.0), "defaults on this device: --width 240 --minutes 10"),
    ],
)
def test_defaults_follow_the_device(
    tiny_dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    device: str, given: list[str], expected: tuple[object, ...], line: str | None,
) -> None:  # fmt: skip
    """No GPU computes here: the method takes the device's name, and means are its model."""
    (tmp_path / "placed.py").write_text((ROOT / "examples" / "method.py").read_text() + PLACED)
    monkeypatch.setattr("mirror.devices.resolve_device", lambda requested, splats: Device(requested, "chosen"))
    method = f"{tmp_path / 'placed.py'}:METHOD"
    words = ["reconstruct", str(tiny_dataset.root), "--split", "novel", "--out", str(tmp_path / "model")]
    assert main([*words, "--method", method, "--device", device, *given]) == ExitCode.DONE
    assert ModelFolder.read(tmp_path / "model", method).method.budgets[-1] == expected  # type: ignore[attr-defined]
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"device: {device} (chosen)" and (lines[1] == line) == (line is not None)
