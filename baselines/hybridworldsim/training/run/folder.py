"""A run folder: what the run is, its checkpoint, its curves, its images, its model."""

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
    """A traversal and camera that was trained on.

    Attributes:
        traversal_id: the traversal.
        camera: of its rig.
        light: of the traversal.
        weather: of the traversal.
        centre_m: (N, 3) some of the places that the camera was at, in the scene's world frame.
        forward: (N, 3) where it looked from there.
    """

    traversal_id: str
    camera: str
    light: str
    weather: str
    centre_m: tuple[tuple[float, float, float], ...]
    forward: tuple[tuple[float, float, float], ...]


class Run(Document):
    """``run.json``: all that decides what comes of a run.

    Attributes:
        format: always ``mirror-run``.
        version: of this document.
        method: its entry point's name.
        settings: of the method.
        seed: of all that is left to chance.
        steps: the budget, or None.
        core_minutes: the budget, or None.
        threads: of torch: results repeat exactly at the same number.
        scene: id.
        split: name.
        block: name within the scene.
        origin_m: of the block's frame, in the scene's world frame.
        radius_m: of the block.
        width_px: images are no wider.
        half: the model is written in half precision.
        dataset_hash: of what the split was made of.
        plan_hash: of the training images, their raster and the layers of masks.
        settings_hash: of the method's settings.
        depth: ``source@version`` of the layers of depth maps that were read, or None.
        points: ``source@version`` of the layers of points that were read, or None.
        poses: layer of poses.
        calibrations: layer of calibrations.
        stage: of calibration, or None for the best of each traversal.
        images: how many are trained on.
        withheld: ``traversal/camera/timestamp_ns`` of training traversals' images that are not looked at.
        sources: traversals and cameras that are trained on.
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
    """``outcome.json``: what came of it, once it is done.

    Attributes:
        steps: images that were learnt from.
        skipped: images of which nothing is scored.
        core_s: processor time of training.
        wall_s: time on the wall, of training.
        psnr_db: of the last images that were trained on; their scored pixels.
        gaussians: held.
        model_bytes: of ``model.safetensors``.
    """

    steps: int
    skipped: int
    core_s: float
    wall_s: float
    psnr_db: float
    gaussians: int
    model_bytes: int


class RunFolder:
    """One run of one block.

    Args:
        path: made if need be.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.pictures, self.model = path, path / "pictures", path / MODEL
        self._checkpoint, self._curves = path / "checkpoint.safetensors", path / "curves.csv"
        self._rows: list[Row] = []

    def begin(self, run: Run) -> TrainingOutcome | None:
        """Say what the run is, or see that it is the one that began here, or that what began here learnt nothing.

        Returns:
            What came of it, if it is done.

        Raises:
            UsageError: the folder holds another run, or something else.
            DatasetError: it is not writable.
        """
        if not (self.path / RUN).exists():
            if is_occupied(self.path):
                raise UsageError("not empty, and no run began here", file=self.path, remedy="name a new folder")
            write_json(self.path / RUN, run)
            return None
        before = read_json(self.path / RUN, Run)
        # What is done is done, whoever did it.
        now = run if self.outcome is None else run.model_copy(update={"threads": before.threads})
        differing = _differing(before.model_dump(mode="json"), now.model_dump(mode="json"))
        if differing and not self._is_untrained:
            elsewhere = "name another folder with --out"
            threads = f"--threads {before.threads}, or {elsewhere}" if before.threads != now.threads else elsewhere
            raise UsageError(
                f"a run of other settings began here: {'; '.join(differing[:4])}", file=self.path,
                expected="the same dataset, method and settings", remedy=threads,
            )  # fmt: skip
        return self.outcome

    def claim(self, run: Run) -> None:
        """Of who is `alone`: make the run this one, where another began and learnt nothing.

        Raises:
            UsageError: another one learnt something meanwhile.
        """
        if self.begin(run) is None:
            write_json(self.path / RUN, run)

    @property
    def _is_untrained(self) -> bool:
        """Whether nothing was learnt yet: what began here failed before it had anything to keep."""
        return self.outcome is None and not self._checkpoint.exists() and not self._curves.exists()

    @property
    def outcome(self) -> TrainingOutcome | None:
        """What came of the run; None: it is not done."""
        path = self.path / OUTCOME
        return read_json(path, TrainingOutcome) if path.exists() else None

    @contextmanager
    def lock(self) -> Iterator[None]:
        """One process at a time trains a run; the lock goes when its holder dies, however it dies.

        Raises:
            DatasetError: another one does.
        """
        with (self.path / ".lock").open("a") as handle:
            try:
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise DatasetError(
                    "another process is training here", file=self.path, remedy="let it finish, or name another folder"
                ) from error
            # Left by a process that was killed; another one's are not touched.
            for left in self.path.glob(f".*{TEMPORARY}"):
                left.unlink(missing_ok=True)
            yield

    def resume(self, trainer: TrainableMethod) -> Position:
        """Take a learner to where the run is; the beginning, where there is no checkpoint yet.

        Raises:
            DatasetError: the checkpoint is broken, or another method's.
        """
        position = Position()
        if self._checkpoint.exists():
            state, position = read_checkpoint(self._checkpoint)
            try:
                trainer.restore(state)
            except KeyError as error:
                raise DatasetError(
                    f"without {error}", file=self._checkpoint, expected="a checkpoint of this version of the method",
                    remedy="remove the run folder and train anew",
                ) from error  # fmt: skip
        self._rows = read_curves(self._curves, position.rows)
        return position

    @property
    def last(self) -> Row:
        """The last row of the curves.

        Raises:
            DatasetError: there is none.
        """
        if not self._rows:
            raise DatasetError("no report yet", file=self._curves, remedy="remove the run folder and train anew")
        return self._rows[-1]

    def save_checkpoint(self, trainer: TrainableMethod, position: Position) -> None:
        """Write a checkpoint."""
        write_checkpoint(self._checkpoint, trainer.state(), position)

    def append_row(self, row: Row, title: str) -> None:
        """Write one more row of the curves, and the chart of a title anew."""
        self._rows.append(row)
        write_curves(self._curves, self._rows)
        write_chart(self.path / "curves.svg", self._rows, title)

    def finish(self, write: Callable[[Path], int], outcome: Mapping[str, Any]) -> TrainingOutcome:
        """Write model and outcome, in this order.

        Args:
            write: writes the model to a path, and says how many bytes it has.
            outcome: but for these bytes.
        """
        size = write(self.model)
        done = TrainingOutcome(**outcome, model_bytes=size)
        write_json(self.path / OUTCOME, done)
        return done


def is_occupied(path: Path) -> bool:
    """Whether a path is a file, or a folder with more in it than what a killed process left behind."""
    if not path.is_dir():
        return path.exists()
    return any(not (one.name.startswith(".") and one.name.endswith(TEMPORARY)) for one in path.iterdir())


def read_run(path: Path) -> Run:
    """The run of a folder.

    Raises:
        DatasetError: none began there.
        SchemaError: its document is broken.
    """
    return read_json(path / RUN, Run)


def _differing(before: Mapping[str, Any], now: Mapping[str, Any], under: str = "") -> list[str]:
    """What two documents differ in, in words."""
    found = []
    for key in before.keys() | now.keys():
        old, new = before.get(key), now.get(key)
        if isinstance(old, dict) and isinstance(new, dict):
            found += _differing(old, new, f"{under}{key}.")
        elif old != new:
            found.append(f"{under}{key} {_short(old)}, now {_short(new)}")
    return sorted(found)


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
