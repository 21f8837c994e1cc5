"""The torch forms that a GPU runs, on the CPU: one step of each part at the paper's size, and trainings that end alike.

``python -m benchmarks plain_torch`` needs no GPU. ``--only sizes`` runs each part once at full size (960 x 540, three
million Gaussians; seven views of 448 x 256) in a process of its own, beside the compiled form where there is one: its
processor time, peak memory, and how far both are apart. ``--only adam`` trains a small street with dense Adam, as on a
GPU, and with lazy Adam, over seeds. ``--only verb`` does what ``mirror reconstruct`` does from images to a model by
either form, over seeds: depth, fusion, sky and 200 steps, which must end within 0.1 dB in the mean.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Annotated, Final

import tyro

from benchmarks.gpu.machine import Machine
from benchmarks.plain_torch.sizes import PARTS
from benchmarks.plain_torch.trainings import compare_adam, compare_forms
from mirror.command_line import parse_arguments
from mirror.devices import CPU
from mirror.errors import ExitCode, UsageError

GROUPS: Final = ("sizes", "adam", "verb")
_LEAST_WIDTH_PX: Final = 16


@dataclass(frozen=True)
class Arguments:
    """Run the torch forms that a GPU runs on the CPU: at full size, and through trainings."""

    only: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = field(default=())
    """sizes, adam or verb; may be repeated. Default: all."""
    part: str | None = None
    """One part of sizes, in this process. Default: all, each in a process of its own."""
    scale: float = 1.0
    """Share of the numbers of Gaussians and pixels."""
    seeds: int = 8
    """Number of seeds of adam and verb; the bars hold for the mean of eight."""
    width: int = 120
    """Width of the images of verb, pixels; the bar holds for 120."""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    arguments = parse_arguments(
        Arguments, argv, "python -m benchmarks plain_torch",
        examples=("python -m benchmarks plain_torch", "python -m benchmarks plain_torch --only sizes --scale 0.05"),
    )  # fmt: skip
    for name in arguments.only:
        _require_known("--only", name, GROUPS)
    if not 0.0 < arguments.scale <= 1.0:
        raise UsageError(f"{arguments.scale:g}", place="--scale", expected="more than 0, and 1 at most")
    if arguments.width < _LEAST_WIDTH_PX:
        raise UsageError(f"{arguments.width}", place="--width", expected=f"{_LEAST_WIDTH_PX} or more")
    if arguments.seeds < 1:
        raise UsageError(f"{arguments.seeds}", place="--seeds", expected="1 or more")
    if arguments.part is not None:
        _require_known("--part", arguments.part, tuple(PARTS))
        print(PARTS[arguments.part](Machine(CPU, arguments.scale)), flush=True)
        return ExitCode.DONE
    chosen = arguments.only or GROUPS
    passed = [
        _run_parts(arguments.scale) if "sizes" in chosen else True,
        compare_adam(arguments.seeds) if "adam" in chosen else True,
        compare_forms(Machine(CPU, 0.1), arguments.seeds, arguments.width) if "verb" in chosen else True,
    ]
    return ExitCode.DONE if all(passed) else ExitCode.FINDINGS


def _run_parts(scale: float) -> bool:
    """Run each part in a process of its own, which prints its line of a table; return whether all ended well."""
    print("| a step of | processor time | memory at most | against the compiled form |\n|---|---|---|---|", flush=True)
    words = [sys.executable, "-m", "benchmarks", "plain_torch", "--scale", str(scale), "--part"]
    codes = [subprocess.run([*words, name], check=False).returncode for name in PARTS]
    return not any(codes)


def _require_known(place: str, name: str, known: Sequence[str]) -> None:
    if name not in known:
        raise UsageError(f"{name!r}", place=place, expected=", ".join(known))
