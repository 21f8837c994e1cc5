"""Where a generator and its autoencoder are, and what is said of one that was trained."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from mirror.errors import UsageError

if TYPE_CHECKING:
    from hybridworldsim.generation.training.documents import GenerationOutcome


def find_model_files(generator: Path, autoencoder: Path | None) -> tuple[Path, Path]:
    """Return the files of a generator and its autoencoder, given as files or as a folder of `mirror generate train`.

    Args:
        generator: the folder, or ``model.safetensors`` of a generator.
        autoencoder: ``model.safetensors`` of an autoencoder; None: the one beside the generator.

    Raises:
        UsageError: a file is missing.
    """
    name = "model.safetensors"
    inner = generator / "generator" / name
    file = inner if inner.is_file() else generator / name if generator.is_dir() else generator
    beside = autoencoder or file.parent.parent / "autoencoder" / name
    for path, place in ((file, "GENERATOR"), (beside, "--autoencoder")):
        if not path.is_file():
            raise UsageError(
                "no such file", file=path, place=place, expected="a model that `mirror generate train` wrote"
            )
    return file, beside


def describe_training(model: Path, outcome: GenerationOutcome) -> str:
    """Describe the training of a model, trained or distilled, in one line."""
    return f"{model}: {outcome.steps} steps, {outcome.core_s / 60.0:.1f} core-minutes, loss {outcome.loss:.5f}"
