"""Trainings that MIRROR 0.1.0 left half done: ``half_done_training.zip``.

``python -m tests.golden.half_done_training`` writes them again, with the clips and models that they are made from.
Today's code must continue each at its step.
"""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Final
from unittest.mock import patch

import numpy as np
import torch

from hybridworldsim.generation.autoencoder.tiny import TinyAutoencoder
from hybridworldsim.generation.model_files import write_autoencoder, write_generator
from hybridworldsim.generation.training.autoencoder_trainer import AutoencoderSettings
from hybridworldsim.generation.training.distillation import DistillationSettings
from hybridworldsim.generation.training.distillation_run import DistillationOptions, distil_on_clips
from hybridworldsim.generation.training.generator_trainer import GeneratorSettings
from hybridworldsim.generation.training.run import TrainingOptions, train_on_clips
from hybridworldsim.petr.tiny.run import train_on_samples
from hybridworldsim.petr.tiny.samples import CameraInput, Sample, TargetBoxes
from hybridworldsim.petr.tiny.settings import NetworkSettings, TrainingSettings
from mirror.annotation.protocol import TrainingTask
from mirror.progress import ProgressReporter
from tests.generation.builders import make_network
from tests.generation.clips import write_clips
from tests.generation.trained import CODEC, NETWORK, T
from tests.interruption import InterruptingProgress
from tests.training.short_run import run
from tests.training.street import Painted

FOLDERS: Final = Path(__file__).with_name("half_done_training.zip")
STEPS: Final = {"street": 60, "autoencoder/autoencoder": 10, "generator/generator": 10, "distilled": 8, "petr": 6}
"""Number of steps of each training, by its folder."""
DONE: Final = {"street": 20, "autoencoder/autoencoder": 4, "generator/generator": 4, "distilled": 3, "petr": 2}
"""Number of steps that were done."""

_SMALL: Final = NetworkSettings(
    width_px=64, height_px=32, channels=(4, 8, 8, 8), dim=16, hidden=16, depths=4, queries=5, proposals=4
)
_SETTINGS: Final = GeneratorSettings(NETWORK, T, batch=4, warmup=2, context_noise=0.3, drop_layout=0.5)


def train_street(root: Path, progress: ProgressReporter) -> None:
    run(root / "street", STEPS["street"], images=Painted(), reporter=progress)


def train_autoencoder(root: Path, progress: ProgressReporter) -> None:
    """Train an autoencoder, and then a generator of few steps."""
    train_on_clips(root / "made" / "clips", root / "autoencoder", _options(2), progress)


def train_generator(root: Path, progress: ProgressReporter) -> None:
    options = replace(_options(STEPS["generator/generator"]), autoencoder=root / "made" / "autoencoder.safetensors")
    train_on_clips(root / "made" / "clips", root / "generator", options, progress)


def distil(root: Path, progress: ProgressReporter) -> None:
    options = DistillationOptions(STEPS["distilled"], DistillationSettings(2, 4), _SETTINGS)
    models = (root / "made" / f"{part}.safetensors" for part in ("generator", "autoencoder"))
    distil_on_clips(root / "made" / "clips", *models, root / "distilled", options, progress)


def train_petr(root: Path, progress: ProgressReporter) -> None:
    """Train a network of few parameters, because no option makes it smaller."""
    with patch("hybridworldsim.petr.tiny.run.NetworkSettings", lambda: _SMALL):
        train_on_samples(
            _samples(), TrainingSettings(batch=2), TrainingTask(STEPS["petr"], None, 3, 1, {}), root / "petr", progress
        )


TRAININGS: Final[dict[str, Callable[[Path, ProgressReporter], None]]] = {
    "street": train_street,
    "autoencoder/autoencoder": train_autoencoder,
    "generator/generator": train_generator,
    "distilled": distil,
    "petr": train_petr,
}


def main() -> None:
    """Write the folders."""
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        write_half_done(root)
        with zipfile.ZipFile(FOLDERS, "w", zipfile.ZIP_DEFLATED) as file:
            for path in sorted(path for path in root.rglob("*") if path.is_file() and path.name != ".lock"):
                name = zipfile.ZipInfo(path.relative_to(root).as_posix())
                file.writestr(name, path.read_bytes(), zipfile.ZIP_DEFLATED)


def write_half_done(root: Path) -> None:
    """Begin each training, and stop it."""
    write_clips(root / "made" / "clips", count=1)
    torch.manual_seed(0)
    write_autoencoder(root / "made" / "autoencoder.safetensors", TinyAutoencoder(CODEC))
    write_generator(root / "made" / "generator.safetensors", make_network(NETWORK).float(), T)
    for name, train in TRAININGS.items():
        with suppress(KeyboardInterrupt):
            train(root, InterruptingProgress(DONE[name]))


def unpack(folder: Path) -> None:
    """Unpack the folders into an empty one."""
    with zipfile.ZipFile(FOLDERS) as file:
        file.extractall(folder)


def _options(steps: int) -> TrainingOptions:
    return TrainingOptions(
        steps=steps,
        autoencoder_steps=STEPS["autoencoder/autoencoder"],
        settings=_SETTINGS,
        autoencoder_settings=AutoencoderSettings(CODEC, batch=2, warmup=2),
    )


def _samples() -> list[Sample]:
    """Three frames of noise, each with one camera and two boxes."""
    rng = np.random.default_rng(0)
    rows, columns, stride = _SMALL.height_px // 8, _SMALL.width_px // 8, 8
    assert rows * stride == _SMALL.height_px
    ahead = np.dstack(np.meshgrid(np.linspace(0.5, -0.5, columns), np.linspace(0.2, -0.2, rows)))
    rays = np.concatenate([np.ones((rows, columns, 1)), ahead], axis=2)
    rays /= np.linalg.norm(rays, axis=2, keepdims=True)
    samples = []
    for _ in range(3):
        cameras = CameraInput(
            rng.integers(0, 256, (1, _SMALL.height_px, _SMALL.width_px, 3), np.uint8),
            rays[None].astype(np.float32),
            np.array([[1.0, 0.0, 1.5]], np.float32),
        )
        centre = rng.uniform((8.0, -4.0, 0.5), (20.0, 4.0, 1.0), (2, 3)).astype(np.float32)
        boxes = TargetBoxes(
            np.array([0, 1]), centre, np.array([[4.0, 2.0, 1.5], [8.0, 2.5, 3.0]], np.float32),
            rng.uniform(-3.0, 3.0, 2).astype(np.float32), rng.uniform(1.0, 3.0, (2, 1, 2)).astype(np.float32),
            np.ones((2, 1), np.float32),
        )  # fmt: skip
        samples.append(Sample(cameras, boxes))
    return samples


if __name__ == "__main__":
    main()
