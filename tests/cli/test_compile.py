"""``mirror compile``: what it refuses; that every function is compiled in it, however small its input is."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import hybridworldsim.small_inputs
import mirror.cli.small_inputs
from hybridworldsim.rasterizer.cpu.projection.unscented import unscented_part_backward
from mirror.calibration.refinement.equations import reduce_equations
from mirror.cli.main import main
from mirror.compiled import COMPILE_ALWAYS
from mirror.metrics.boxes.overlap_kernels import overlaps

_COUNT: str = """
import numpy as np
from mirror.ingest.fix_status import count_backward
count_backward(np.arange(3))
print(len(count_backward.overloads))
"""


@pytest.mark.parametrize("words", [["--cache", "{file}/kernels"], ["--cache", "{file}"], ["--workers", "0"]])
def test_a_cache_that_cannot_be_written_and_no_workers_are_refused(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "file"
    file.write_text("")
    assert main(["compile", *(word.format(file=file) for word in words)]) == 2
    said = capsys.readouterr().err
    assert words[0] in said
    assert "compiling" not in said


def test_kernels_of_the_cpu_are_compiled_on_a_machine_with_a_gpu_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """The verb that trains would take the GPU otherwise, and compile nothing."""
    commands: list[list[str]] = []

    def run(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        commands.append(command)
        return subprocess.CompletedProcess(command, 0)

    monkeypatch.setattr(subprocess, "run", run)
    assert main(["compile", "--workers", "1"]) == 0
    (training,) = (words for words in commands if "reconstruct" in words)
    assert training[training.index("--device") + 1] == "cpu"


def test_functions_are_compiled_for_small_inputs_only_where_all_are(tmp_path: Path) -> None:
    for more, expected in (({}, "0"), ({COMPILE_ALWAYS: "1"}, "1"), ({}, "1")):
        environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)} | more
        done = subprocess.run(
            [sys.executable, "-c", _COUNT], env=environment, capture_output=True, text=True, check=True
        )
        assert done.stdout.strip() == expected


@pytest.mark.parametrize(
    ("call", "functions"),
    [
        (mirror.cli.small_inputs.main, (overlaps, reduce_equations)),
        (hybridworldsim.small_inputs.main, (unscented_part_backward,)),
    ],
)
def test_small_inputs_reach_functions_that_no_verb_does(call: Callable[[], None], functions: tuple[Any, ...]) -> None:
    call()
    assert all(function.overloads for function in functions)
