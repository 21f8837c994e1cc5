"""A run folder: the run's document, its checkpoint, its curves, its model and its outcome."""

from __future__ import annotations

import fcntl
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Generic

from hybridworldsim.training.run.checkpoint import read_checkpoint, write_checkpoint
from hybridworldsim.training.run.curves import Row, read_curves, write_curves
from hybridworldsim.training.run.document import RUN, begin_run, require_same_run
from hybridworldsim.training.run.position import Position
from hybridworldsim.training.run.processes import ALONE, Processes
from hybridworldsim.training.run.training import Ending, OutcomeT, Stateful, Training
from mirror.errors import DatasetError
from mirror.schema.documents import Document
from mirror.schema.files import TEMPORARY, read_json, write_json

OUTCOME: Final = "outcome.json"
MODEL: Final = "model.safetensors"

_AGAIN: Final = "remove the run folder and train again"


class RunFolder(Generic[OutcomeT]):
    """The folder of one run. Of several processes that train together, only the leading one writes.

    Args:
        path: the folder; it is created if needed.
        outcome: type of the outcome's document.
        processes: those that train together.

    Attributes:
        path: the folder.
        model: file of the trained model.
        processes: those that train together.
    """

    def __init__(self, path: Path, outcome: type[OutcomeT], processes: Processes = ALONE) -> None:
        self.path, self.model, self.processes = path, path / MODEL, processes
        self._outcome, self._rows = outcome, list[Row]()
        self._checkpoint, self._curves = path / "checkpoint.safetensors", path / "curves.csv"

    @property
    def outcome(self) -> OutcomeT | None:
        """The result of the run; None until it is finished."""
        path = self.path / OUTCOME
        return read_json(path, self._outcome) if path.exists() else None

    @property
    def rows(self) -> list[Row]:
        """The rows of the curves so far."""
        return list(self._rows)

    def begin(self, run: Document) -> OutcomeT | None:
        """Write the run's document, or require that it equals the document of an earlier run that learned something.

        Args:
            run: everything that determines the result of the run, with a field `threads`.

        Returns:
            The outcome, if the run is finished.

        Raises:
            UsageError: the folder holds another run or other files.
            DatasetError: the folder is not writable, or the leading process stopped.
        """
        with self.processes.leader_first():
            return self._begin(run)

    def require_same(self, kind: type[Document], stated: Mapping[str, Any]) -> None:
        """Require that an earlier run, if it learned something, has the same values; called before data is read.

        Args:
            kind: type of the run's document.
            stated: values of the document as JSON, with `threads`.

        Raises:
            UsageError: a value differs.
        """
        if self._has_learned:
            require_same_run(self.path, kind, stated, finished=self.outcome is not None)

    @contextmanager
    def claim(self, run: Document) -> Iterator[None]:
        """Replace, under the `lock`, the document of another run if that run learned nothing.

        The lock ends with its process, even if the process is killed.

        Raises:
            DatasetError: another process holds the lock.
            UsageError: the other run has learned something meanwhile.
        """
        if not self.processes.leads:
            yield
            return
        with lock_run(self.path):
            if self._begin(run) is None:
                write_json(self.path / RUN, run)
            yield

    def resume(self, trained: Stateful) -> Position:
        """Restore the trained state from the checkpoint, if there is one, and return the position.

        Raises:
            DatasetError: the checkpoint is broken or belongs to another model.
        """
        position = Position()
        if self._checkpoint.exists():
            state, position = read_checkpoint(self._checkpoint)
            try:
                trained.restore(state)
            except KeyError as error:
                raise DatasetError(
                    f"without {error}", file=self._checkpoint, expected="a checkpoint of this version", remedy=_AGAIN
                ) from error
        self._rows = read_curves(self._curves, position.rows)
        return position

    def save_checkpoint(self, training: Training[OutcomeT], position: Position) -> None:
        """Write a checkpoint.

        Raises:
            DatasetError: a number is not finite, or the folder is not writable; the last checkpoint is kept.
        """
        if self.processes.leads:
            self.require_finite(training, position)
            write_checkpoint(self._checkpoint, training.trained.state(), position)

    def require_finite(self, training: Training[OutcomeT], position: Position) -> None:
        """Check that all learned parameters are finite.

        Raises:
            DatasetError: a number is not finite.
        """
        for name, tensor in training.learned():
            # A sum is finite only if all terms are; it is the cheapest test.
            if not bool(tensor.detach().sum().isfinite()):
                raise DatasetError(
                    f"{name} holds numbers that are not finite at step {position.steps}", file=self.path,
                    expected="finite parameters", remedy=training.remedy,
                )  # fmt: skip

    def append_row(self, row: Row) -> None:
        """Append a row to the curves."""
        self._rows.append(row)
        if self.processes.leads:
            write_curves(self._curves, self._rows)

    def finish(self, training: Training[OutcomeT], position: Position) -> OutcomeT:
        """Write the model, then the outcome, and return the outcome.

        Raises:
            DatasetError: there is no row of the curves, the folder is not writable, or the leading process stopped.
        """
        with self.processes.leader_first():
            if self.processes.leads:
                if not self._rows:
                    raise DatasetError("no report yet", file=self._curves, remedy=_AGAIN)
                size = training.write(self.model)
                write_json(self.path / OUTCOME, training.outcome(Ending(position, self._rows[-1], size)))
        done = self.outcome
        if done is None:
            raise DatasetError("the leading process did not finish", file=self.path, expected="an outcome")
        return done

    def _begin(self, run: Document) -> OutcomeT | None:
        outcome = self.outcome
        begin_run(self.path, run, finished=outcome is not None, untrained=not self._has_learned)
        return outcome

    @property
    def _has_learned(self) -> bool:
        return self.outcome is not None or self._checkpoint.exists() or self._curves.exists()


@contextmanager
def lock_run(path: Path) -> Iterator[None]:
    """Lock a run for one process; the lock ends with its process, even if the process is killed.

    Raises:
        DatasetError: another process holds the lock.
    """
    with (path / ".lock").open("a") as handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise DatasetError(
                "another process is training here", file=path, remedy="let it finish, or name another folder"
            ) from error
        # Temporary files of a killed process; under the lock no other process writes here.
        for leftover in path.glob(f".*{TEMPORARY}"):
            leftover.unlink(missing_ok=True)
        yield
