"""Training of a generator by two processes of `torchrun`: the model is that of one process, also after Ctrl-C.

The tests share a process's imports by a fork. This check starts the real program, which costs more processor time than
a test may.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

import numpy as np

from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder, TinySettings
from hybridworldsim.generation.clips.clip import Clip, ClipBoxes
from hybridworldsim.generation.clips.folder import ClipList, write_clip, write_list
from hybridworldsim.generation.model_files import read_generator, write_autoencoder
from mirror.errors import ExitCode

STEPS: Final = 12
_CODE: Final = "import sys; from mirror.cli.main import main; sys.exit(main())"
_PROGRAM: Final = (sys.executable, "-m", "torch.distributed.run", "--nproc-per-node", "2", "--no-python")
LARGEST_DIFFERENCE: Final = 1e-4
"""Of a parameter, between two processes and one: sums have another order."""


def main(argv: list[str]) -> int:
    """Train with two processes, with two that are interrupted, and with one; compare the parameters."""
    if argv:
        print("usage: python -m benchmarks generation_processes")
        return ExitCode.DONE if argv[0] in ("-h", "--help") else ExitCode.COULD_NOT_RUN
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_clips(folder / "clips")
        write_autoencoder(folder / "autoencoder.safetensors", TinyAutoencoder(TinySettings()))
        _train(folder, "one", "--accumulate", "2")
        _train(folder, "two", program=_PROGRAM)
        _interrupt(folder, "stopped")
        _train(folder, "stopped", program=_PROGRAM)
        found = {out: (folder / out / "generator" / "model.safetensors") for out in ("one", "two", "stopped")}
        one, two = (read_generator(found[out])[0] for out in ("one", "two"))
        far = max(float((a - b).abs().max()) for a, b in zip(one.parameters(), two.parameters(), strict=True))
        same = found["two"].read_bytes() == found["stopped"].read_bytes()
    print(f"two processes against one: largest difference of a parameter {far:.1e} (at most {LARGEST_DIFFERENCE:.0e})")
    print(f"interrupted and continued: {'the same bytes' if same else 'other bytes'}")
    return ExitCode.DONE if same and far <= LARGEST_DIFFERENCE else ExitCode.FINDINGS


def _words(folder: Path, out: str) -> list[str]:
    train = ["generate", "train", str(folder / "clips"), "--steps", str(STEPS), "--batch", "2", "--device", "cpu"]
    return [*train, "--autoencoder", str(folder / "autoencoder.safetensors"), "--out", str(folder / out)]


def _command(program: tuple[str, ...]) -> list[str]:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    return [*program, *(("--master-port", str(port)) if program else ()), sys.executable, "-c", _CODE]


def _train(folder: Path, out: str, *more: str, program: tuple[str, ...] = ()) -> None:
    subprocess.run([*_command(program), *_words(folder, out), *more], env=_environment(), check=True)


def _interrupt(folder: Path, out: str) -> None:
    """Send Ctrl-C after the first report; the leading process must leave a checkpoint."""
    command = [*_command(_PROGRAM), *_words(folder, out)]
    with subprocess.Popen(command, env=_environment(), stderr=subprocess.PIPE, text=True) as running:
        said = ""
        for line in running.stderr or ():
            said += line
            if "step 1 " in line:
                running.send_signal(signal.SIGINT)
    if "interrupted at step" not in said or "gloo" in said:
        raise SystemExit(f"not interrupted between steps:\n{said}")
    print(next(line for line in said.splitlines() if "interrupted at step" in line))


def _environment() -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1"}


def _write_clips(folder: Path) -> None:
    """One clip of noise with one box, for a network of the default size."""
    rng = np.random.default_rng(0)
    frames, views, height, width = 8, 2, 16, 24
    images = rng.integers(0, 256, (frames, views, height, width, 3), np.uint8)
    mounts = np.tile(np.eye(4), (views, 1, 1))
    mounts[:, :3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    lens = np.array([[20.0, 0.0, width / 2], [0.0, 20.0, height / 2], [0.0, 0.0, 1.0]])
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, 0, 3] = 10.0
    number = np.arange(frames, dtype=np.int64)
    boxes = ClipBoxes(number, 0 * number, 0 * number, poses, np.tile((4.0, 2.0, 1.5), (frames, 1)))
    clip = Clip(
        "noise", "drive", 5.0, ("left", "right"), images, images, np.ones((frames, views), np.bool_),
        np.tile(lens, (views, 1, 1)), mounts, np.tile(np.eye(4), (frames, 1, 1)), boxes,
    )  # fmt: skip
    write_clip(folder, clip)
    write_list(folder, ClipList(source="noise", training=("noise",), test=()))
