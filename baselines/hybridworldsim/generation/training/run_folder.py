"""The run folder of an autoencoder or of a generator: document, checkpoint, curves, samples, model, outcome."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Literal, Protocol

from torch import Tensor

from hybridworldsim.training.run.checkpoint import Position, read_checkpoint, write_checkpoint
from hybridworldsim.training.run.curves import Row, read_curves, write_curves
from hybridworldsim.training.run.folder import MODEL, OUTCOME, begin_run, lock_run
from mirror.errors import DatasetError
from mirror.schema.documents import Document
from mirror.schema.files import read_json, write_json

_CHECKPOINT: Final = "checkpoint.safetensors"
_CURVES: Final = "curves.csv"


class Trainer(Protocol):
    """What is trained: a step depends on its number, the seed and the state only."""

    def step(self, number: int) -> dict[str, float]:
        """Do a step; returns the losses by name."""
        ...

    def state(self) -> dict[str, Tensor]:
        """Everything that a run needs to continue, by name."""
        ...

    def restore(self, state: Mapping[str, Tensor]) -> None:
        """Continue from the result of `state`."""
        ...


class GenerationRun(Document):
    """``run.json``: everything that determines the result of a run.

    Attributes:
        format: always ``mirror-generation-run``.
        version: version of this document.
        part: what is trained, such as ``autoencoder`` or ``generator``.
        settings: settings of the training.
        seed: seed of all random numbers.
        steps: number of steps.
        threads: number of torch threads; results repeat exactly with the same number.
        processes: number of processes.
        clips_hash: hash of the clips.
        autoencoder_hash: hash of the autoencoder's file, or None for an autoencoder.
    """

    format: Literal["mirror-generation-run"] = "mirror-generation-run"
    version: Literal["1"] = "1"
    part: str
    settings: dict[str, Any]
    seed: int
    steps: int
    threads: int
    processes: int
    clips_hash: str
    autoencoder_hash: str | None


class GenerationOutcome(Document):
    """``outcome.json``: the result of a finished run.

    Attributes:
        steps: number of steps.
        core_s: processor time of training.
        wall_s: wall time of training.
        loss: mean loss of the last fortieth of the steps.
        model_bytes: size of ``model.safetensors``.
        psnr_db: PSNR of reconstructed images, for an autoencoder.
    """

    steps: int
    core_s: float
    wall_s: float
    loss: float
    model_bytes: int
    psnr_db: float | None = None


class GenerationRunFolder:
    """The folder of one run.

    Args:
        path: the folder; it is created if needed.

    Attributes:
        path: the folder.
        samples: folder of the images that are generated during training.
        model: the trained model.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.samples, self.model = path, path / "samples", path / MODEL
        self._rows: list[Row] = []

    def begin(self, run: GenerationRun) -> GenerationOutcome | None:
        """Write the run's document, or require that it equals the earlier one.

        Returns:
            The outcome, if the run is finished.

        Raises:
            UsageError: the folder holds another run or other files.
            DatasetError: the folder is not writable.
        """
        outcome = self.outcome
        untrained = outcome is None and not any((self.path / name).exists() for name in (_CHECKPOINT, _CURVES))
        begin_run(self.path, run, finished=outcome is not None, untrained=untrained)
        return outcome

    @property
    def outcome(self) -> GenerationOutcome | None:
        """The result of the run; None while it is not finished."""
        path = self.path / OUTCOME
        return read_json(path, GenerationOutcome) if path.exists() else None

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Lock the run for one process.

        Raises:
            DatasetError: another process holds the lock.
        """
        with lock_run(self.path):
            yield

    def resume(self, trainer: Trainer) -> Position:
        """Restore a trainer from the checkpoint, if there is one, and return the position.

        Raises:
            DatasetError: the checkpoint is broken or belongs to another model.
        """
        position, path = Position(), self.path / _CHECKPOINT
        if path.exists():
            state, position = read_checkpoint(path)
            try:
                trainer.restore(state)
            except KeyError as error:
                raise DatasetError(
                    f"without {error}", file=path, expected="a checkpoint of this version",
                    remedy="remove the run folder and train again",
                ) from error  # fmt: skip
        self._rows = read_curves(self.path / _CURVES, position.rows)
        return position

    def save_checkpoint(self, trainer: Trainer, position: Position) -> None:
        """Write a checkpoint.

        Raises:
            DatasetError: a tensor is not finite, or the folder is not writable; the last checkpoint is kept.
        """
        state = trainer.state()
        for name, tensor in state.items():
            if not bool(tensor.sum().isfinite()):
                raise DatasetError(
                    f"{name} holds numbers that are not finite at step {position.steps}", file=self.path,
                    expected="finite parameters", remedy="train again with a lower learning rate",
                )  # fmt: skip
        write_checkpoint(self.path / _CHECKPOINT, state, position)

    def append_row(self, row: Row) -> None:
        """Append a row to the curves."""
        self._rows.append(row)
        write_curves(self.path / _CURVES, self._rows)

    def finish(
        self, write: Callable[[Path], int], position: Position, loss: str, psnr_db: float | None = None
    ) -> GenerationOutcome:
        """Write the model, then the outcome.

        Args:
            write: writes the model to a path, and returns its size in bytes.
            position: the last position.
            loss: name of the loss in the curves.
            psnr_db: see `GenerationOutcome`.
        """
        size = write(self.model)
        done = GenerationOutcome(
            steps=position.steps, core_s=position.spent_s, wall_s=position.wall_s,
            loss=self._rows[-1][loss], model_bytes=size, psnr_db=psnr_db,
        )  # fmt: skip
        write_json(self.path / OUTCOME, done)
        return done
