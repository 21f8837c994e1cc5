"""A plug-in in a file that does not fit its host is named before the work, whatever its kind."""

from __future__ import annotations

from pathlib import Path

import pytest

from mirror.cli.main import main
from mirror.dataset.dataset import Dataset
from mirror.errors import ExitCode

RECONSTRUCT = "reconstruct {dataset} --split novel --method {file}:X --out {out}"
SIMULATE = "simulate synth:tiny --scenario free-traffic --policy {file}:X --out {out}"
ANNOTATE = "annotate {dataset} --annotator {file}:X"
INGEST = "ingest {dataset} --roi 11.5,48.1 --reader {file}:X --out {out}"

METHOD = "class M:\n    def reconstruct(self, {}): ...\n    def open(self, {}): ...\nX = M()\n"
POLICY = """
class X:
    cameras = ()
    privileged = False
    def __init__(self{}): ...
    def reset(self, spec): ...
    def act(self{}): ...
    def close(self): ...
"""
READER = "class X:\n    name = expects = 'x'\n    def recognises(self, path): ...\n    def open(self, {}): ...\n"
ANNOTATOR = "class A:\n    settings = {{}}\n    def open(self, dataset, settings, device): return {}\nX = A()\n"


@pytest.mark.parametrize(
    ("words", "text", "named"),
    [
        (RECONSTRUCT, METHOD.format("dataset", "model, appearance"), "reconstruct does not take the arguments"),
        (RECONSTRUCT, METHOD.format("*all", "model"), "expected open(model, appearance)"),
        (RECONSTRUCT, "class X:\n    reconstruct = open = print\n", "a class, not an object"),
        (RECONSTRUCT, "X = None\n", "it has no open, reconstruct"),
        (RECONSTRUCT, "import sys\nsys.exit(0)\n", "the file ends the program when it is imported"),
        (SIMULATE, "X = 5\n", "X is int, which cannot be called"),
        (SIMULATE, POLICY.format(", path", ", seen"), "X does not take the arguments of its host"),
        (SIMULATE, POLICY.format("", ""), "expected act(observation)"),
        (SIMULATE, POLICY.format("", ", seen").replace("()", "('roof',)", 1), "reads the images of roof"),
        (SIMULATE, "class X: ...\n", "it has no act, cameras, close, privileged, reset"),
        (SIMULATE, "raise SystemExit(3)\n", "the file ends the program when it is imported"),
        (ANNOTATE, "X = 5\n", "it has no open, settings"),
        (ANNOTATE, "class A:\n    settings = {}\n    open = 3\nX = A()\n", "open is int, which cannot be called"),
        (ANNOTATE, ANNOTATOR.format("7"), "it has no annotate, close, fingerprint, name, version"),
        (INGEST, "class X:\n    def __init__(self, path): ...\n", "X does not take the arguments of its host"),
        (INGEST, "class X:\n    name = 'x'\n    recognises = open = print\n", "it has no expects"),
        (INGEST, READER.format("path"), "expected open(path, options)"),
        (INGEST, "exit(0)\n", "the file ends the program when it is imported"),
    ],
)
def test_a_plugin_that_does_not_fit_is_named(
    tiny_dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: str, text: str, named: str
) -> None:
    file, out = tmp_path / "plugin.py", tmp_path / "out"
    file.write_text(text)
    code = main(words.format(dataset=tiny_dataset.root, file=file, out=out).split())
    said = capsys.readouterr()
    assert code == ExitCode.COULD_NOT_RUN
    assert named in said.out + said.err
    assert "plugin.py" in said.out + said.err
    assert "Remedy: m" in said.out + said.err  # Mend the plug-in, or move what runs.
    assert not out.exists()


def test_a_renderer_that_is_none_is_named(
    tiny_dataset: Dataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # The method also writes nothing and takes no time: neither is a cost that a manifest can state.
    file = tmp_path / "plugin.py"
    file.write_text(
        "from mirror.methods import ReconstructionResult\n\nclass M:\n"
        "    def reconstruct(self, dataset, task, out, progress): return ReconstructionResult(out)\n"
        "    def open(self, model, appearance): return 5\nX = M()\n"
    )
    words = ("--split", "novel", "--method", f"{file}:X", "--out")
    assert main(["reconstruct", str(tiny_dataset.root), *words, str(tmp_path / "model")]) == ExitCode.DONE
    model, out = str(tmp_path / "model"), str(tmp_path / "submission")
    assert main(["render", str(tiny_dataset.root), model, *words, out]) == ExitCode.COULD_NOT_RUN
    assert "open returned int; expected a function" in capsys.readouterr().err
