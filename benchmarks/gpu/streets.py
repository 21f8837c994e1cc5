"""The street that is trained on and driven in: recordings, dataset, split and depth, made once in a folder."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from benchmarks.gpu.machine import Machine
from benchmarks.report import OUT
from hybridworldsim.training.run.curves import Row, read_curves
from mirror.errors import DatasetError

SPLIT: Final = "novel"
LAYERS: Final = "plane-sweep@gpu"
_SEED: Final = "0"
_PROGRAM: Final = (sys.executable, "-c", "import sys; from mirror.cli.main import main; sys.exit(main())")
_MOST_ROWS: Final = 1000


@dataclass(frozen=True)
class StreetData:
    """A dataset of one block of a synthetic street, with layers of depth.

    Attributes:
        folder: its folder.
        preset: the preset of the recordings.
    """

    folder: Path
    preset: str

    @property
    def dataset(self) -> Path:
        """Return the folder of the dataset."""
        return self.folder / "dataset"

    @property
    def is_made(self) -> bool:
        """Return whether the dataset is complete."""
        return (self.folder / "complete").is_file()


def choose_street(machine: Machine, folder: Path | None) -> StreetData:
    """Return the street for a machine's scale: a block in images of 960 pixels, or a tiny one for a dry run."""
    preset = "block-960" if machine.scale == 1.0 else "tiny"
    return StreetData(folder or OUT / "gpu" / preset, preset)


def make_street(street: StreetData) -> None:
    """Make the dataset; a second call continues. Depth is estimated at 240 pixels, which the losses of depth read."""
    if street.is_made:
        return
    out, dataset = street.folder, str(street.dataset)
    recordings = out / "recordings"
    run_mirror(["synth", "--out", str(recordings), "--preset", street.preset, "--seed", _SEED])
    drives = sorted(str(path.parent) for path in recordings.glob("*/recording.json"))
    rois, maps = str(recordings / "rois.geojson"), str(recordings / "maps")
    run_mirror(["ingest", *drives, "--rois", rois, "--map", maps, "--out", dataset, "--licence", "CC0-1.0"])
    if not (street.dataset / "splits" / f"{SPLIT}.json").is_file():
        counts = ["--train", "1", "--held-out-traversals", "1"] if street.preset == "tiny" else []
        run_mirror(["split", dataset, SPLIT, "--seed", _SEED, *counts])
    version = LAYERS.partition("@")[2]
    run_mirror(["depth", dataset, "--split", SPLIT, "--version", version, "--device", "cpu"])
    (out / "complete").touch()


def run_mirror(words: Sequence[str], limit_s: float | None = None) -> float | None:
    """Run a verb in a process of its own, offline.

    Args:
        words: the words after ``mirror``.
        limit_s: seconds after which it is interrupted, as by Ctrl-C; None: none.

    Returns:
        Its seconds; None if it was interrupted.

    Raises:
        DatasetError: it failed.
    """
    print(f"$ mirror {' '.join(words)}", flush=True)
    begin = time.monotonic()
    with subprocess.Popen([*_PROGRAM, *words], env={**os.environ, "PYTHONUNBUFFERED": "1"}) as running:
        try:
            code = running.wait(limit_s)
        except subprocess.TimeoutExpired:
            running.send_signal(signal.SIGINT)
            running.wait()
            return None
    if code:
        raise DatasetError(
            f"mirror {words[0]} ended with exit code {code}", expected="0",
            remedy="see its message above, and run the benchmark again",
        )  # fmt: skip
    return time.monotonic() - begin


def read_training(model: Path) -> list[Row]:
    """Return the rows of the curves of a model's only or largest block, so far."""
    curves = sorted(model.glob("*/curves.csv"), key=lambda path: path.stat().st_size)
    return read_curves(curves[-1], _MOST_ROWS) if curves else []
