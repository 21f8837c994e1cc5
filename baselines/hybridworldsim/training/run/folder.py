"""A run folder: the run's document, its checkpoint, its curves, its previews and its model."""

from __future__ import annotations

import fcntl
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, Literal

from hybridworldsim.training.run.checkpoint import Position, read_checkpoint, write_checkpoint
from hybridworldsim.training.run.curves import Row, read_curves, write_chart, write_curves
from hybridworldsim.training.trainable_method import TrainableMethod
from mirror.errors import DatasetError, UsageError
from mirror.schema.documents import Document
from mirror.schema.files import TEMPORARY, read_json, write_json

RUN: Final = "run.json"
OUTCOME: Final = "outcome.json"
MODEL: Final = "model.safetensors"


class TrainedCamera(Document):
    """A camera in a traversal that was trained on.

    Attributes:
        traversal_id: the traversal.
        camera: name of the camera in the rig.
        light: light of the traversal.
        weather: weather of the traversal.
        centre_m: (N, 3) some of the camera's positions, in the scene's world frame.
        forward: (N, 3) viewing directions at these positions.
    """

    traversal_id: str
    camera: str
    light: str
    weather: str
    centre_m: tuple[tuple[float, float, float], ...]
    forward: tuple[tuple[float, float, float], ...]


class Run(Document):
    """``run.json``: everything that determines the result of a run.

    Attributes:
        format: always ``mirror-run``.
        version: version of this document.
        method: name of the method's entry point.
        settings: settings of the method.
        seed: seed of all random numbers.
        steps: the budget, or None.
        core_minutes: the budget, or None.
        threads: number of torch threads; results repeat exactly with the same number.
        scene: id of the scene.
        split: name of the split.
        block: name of the block within the scene.
        origin_m: origin of the block's frame, in the scene's world frame.
        radius_m: radius of the block.
        width_px: largest width of images.
        half: whether the model is written in half precision.
        dataset_hash: hash of the data that the split was made of.
        plan_hash: hash of the training images, their raster and the layers of masks.
        settings_hash: hash of the method's settings.
        depth: ``source@version`` of the layers of depth maps, or None.
        points: ``source@version`` of the layers of points, or None.
        poses: layer of poses.
        calibrations: layer of calibrations.
        stage: stage of calibration, or None for the best of each traversal.
        pictures: number of training images.
        withheld: ``traversal/camera/timestamp_ns`` of images of training traversals that are not read.
        sources: trained traversals and cameras.
    """

    format: Literal["mirror-run"] = "mirror-run"
    version: Literal["1"] = "1"
    method: str
    settings: dict[str, Any]
    seed: int
    steps: int | None
    core_minutes: float | None
    threads: int
    scene: str
    split: str
    block: str
    origin_m: tuple[float, float, float]
    radius_m: float
    width_px: int
    half: bool
    dataset_hash: str
    plan_hash: str
    settings_hash: str
    depth: str | None
    points: str | None
    poses: str = "recorded"
    calibrations: str = "recorded"
    stage: str | None = None
    pictures: int
    withheld: tuple[str, ...] = ()
    sources: tuple[TrainedCamera, ...]


class TrainingOutcome(Document):
    """``outcome.json``: the result of a finished run.

    Attributes:
        steps: number of images trained on.
        skipped: number of images without a scored pixel.
        core_s: processor time of training.
        wall_s: wall time of training.
        psnr_db: PSNR of the last training images, over their scored pixels.
        gaussians: number of Gaussians.
        model_bytes: size of ``model.safetensors``.
    """

    steps: int
    skipped: int
    core_s: float
    wall_s: float
    psnr_db: float
    gaussians: int
    model_bytes: int


class RunFolder:
    """The folder of one run of one block.

    Args:
        path: the folder; it is created if needed.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.previews, self.model = path, path / "pictures", path / MODEL
        self._checkpoint, self._curves = path / "checkpoint.safetensors", path / "curves.csv"
        self._rows: list[Row] = []

    def begin(self, run: Run) -> TrainingOutcome | None:
        """Write the run's document, or require that it equals the earlier one, unless the earlier run learned nothing.

        Returns:
            The outcome, if the run is finished.

        Raises:
            UsageError: the folder holds another run or other files.
            DatasetError: the folder is not writable.
        """
        begin_run(self.path, run, finished=self.outcome is not None, untrained=self._is_untrained)
        return self.outcome

    def claim(self, run: Run) -> None:
        """Under the `lock`, replace the document of another run that had learned nothing.

        Raises:
            UsageError: the other run has learned something meanwhile.
        """
        if self.begin(run) is None:
            write_json(self.path / RUN, run)

    @property
    def _is_untrained(self) -> bool:
        """Return whether nothing has been saved yet, because the run failed early."""
        return self.outcome is None and not self._checkpoint.exists() and not self._curves.exists()

    @property
    def outcome(self) -> TrainingOutcome | None:
        """The result of the run; None while it is not finished."""
        path = self.path / OUTCOME
        return read_json(path, TrainingOutcome) if path.exists() else None

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Lock the run for one process; the lock ends with its process, even if the process is killed.

        Raises:
            DatasetError: another process holds the lock.
        """
        with lock_run(self.path):
            yield

    def resume(self, trainer: TrainableMethod) -> Position:
        """Restore a trainer from the checkpoint, if there is one, and return the position.

        Raises:
            DatasetError: the checkpoint is broken or belongs to another method.
        """
        position = Position()
        if self._checkpoint.exists():
            state, position = read_checkpoint(self._checkpoint)
            try:
                trainer.restore(state)
            except KeyError as error:
                raise DatasetError(
                    f"without {error}", file=self._checkpoint, expected="a checkpoint of this version of the method",
                    remedy="remove the run folder and train again",
                ) from error  # fmt: skip
        self._rows = read_curves(self._curves, position.rows)
        return position

    @property
    def last(self) -> Row:
        """The last row of the curves.

        Raises:
            DatasetError: there is no row.
        """
        if not self._rows:
            raise DatasetError("no report yet", file=self._curves, remedy="remove the run folder and train again")
        return self._rows[-1]

    def save_checkpoint(self, trainer: TrainableMethod, position: Position) -> None:
        """Write a checkpoint."""
        write_checkpoint(self._checkpoint, trainer.state(), position)

    def append_row(self, row: Row, title: str) -> None:
        """Append a row to the curves, and write the chart again."""
        self._rows.append(row)
        write_curves(self._curves, self._rows)
        write_chart(self.path / "curves.svg", self._rows, title)

    def finish(self, write: Callable[[Path], int], outcome: Mapping[str, Any]) -> TrainingOutcome:
        """Write the model, then the outcome.

        Args:
            write: writes the model to a path, and returns its size in bytes.
            outcome: fields of the outcome, without the model's size.
        """
        size = write(self.model)
        done = TrainingOutcome(**outcome, model_bytes=size)
        write_json(self.path / OUTCOME, done)
        return done


def begin_run(path: Path, run: Document, *, finished: bool, untrained: bool) -> None:
    """Write a run's document, or require that it equals the earlier one, unless the earlier run learned nothing.

    Args:
        path: folder of the run.
        run: the document, with a field `threads`.
        finished: whether the earlier run is finished; then its number of threads does not matter.
        untrained: whether the earlier run has saved nothing.

    Raises:
        UsageError: the folder holds another run or other files.
        DatasetError: the folder is not writable.
    """
    if not (path / RUN).exists():
        if is_occupied(path):
            raise UsageError("not empty, and not the folder of a run", file=path, remedy="name a new folder")
        write_json(path / RUN, run)
        return
    before = read_json(path / RUN, type(run)).model_dump(mode="json")
    current = run.model_dump(mode="json")
    differing = _differing(before, current | {"threads": before["threads"]} if finished else current)
    if differing and not untrained:
        elsewhere = "name another folder with --out"
        same = before["threads"] == current["threads"]
        raise UsageError(
            f"a run of other settings began here: {'; '.join(differing[:4])}", file=path,
            expected="the same dataset, method and settings",
            remedy=elsewhere if same or finished else f"--threads {before['threads']}, or {elsewhere}",
        )  # fmt: skip


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


def is_occupied(path: Path) -> bool:
    """Return whether a path is a file, or a folder that holds more than temporary files of a killed process."""
    if not path.is_dir():
        return path.exists()
    return any(not (entry.name.startswith(".") and entry.name.endswith(TEMPORARY)) for entry in path.iterdir())


def read_run(path: Path) -> Run:
    """Read the document of a run.

    Raises:
        DatasetError: no run began in the folder.
        SchemaError: the document is broken.
    """
    return read_json(path / RUN, Run)


def _differing(before: Mapping[str, Any], current: Mapping[str, Any], under: str = "") -> list[str]:
    """The differences of two documents, in words."""
    differences = []
    for key in before.keys() | current.keys():
        old, new = before.get(key), current.get(key)
        if isinstance(old, dict) and isinstance(new, dict):
            differences += _differing(old, new, f"{under}{key}.")
        elif old != new:
            differences.append(f"{under}{key} {_short(old)}, now {_short(new)}")
    return sorted(differences)


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
