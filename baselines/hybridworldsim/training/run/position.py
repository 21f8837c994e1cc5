"""How far a run is: its position, which adds up the results of its steps; checkpoints hold it as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from pydantic import RootModel

from hybridworldsim.training.run.budget import Clock
from hybridworldsim.training.run.curves import Row


@dataclass(frozen=True)
class Step:
    """The result of a step.

    Attributes:
        losses: by name; a loss may be absent from some steps.
        psnr_db: PSNR of what the step learned from; None: there are no images.
        shown: number of examples that the step read from a stream, including those that taught nothing.
        sizes: further figures, such as the number of Gaussians; a row of the curves has those of its last step.
        place: what the step learned from, for messages.
    """

    losses: Mapping[str, float]
    psnr_db: float | None = None
    shown: int = 0
    sizes: Mapping[str, float] = field(default_factory=dict)
    place: str | None = None


@dataclass(frozen=True)
class Sums:
    """Sums over the steps since the last report.

    Attributes:
        steps: number of steps.
        psnr_db: sum of their PSNR.
        losses: by name, the sum and the number of steps in which the loss was computed.
    """

    steps: int = 0
    psnr_db: float = 0.0
    losses: Mapping[str, tuple[float, int]] = field(default_factory=dict)

    def after(self, step: Step) -> Sums:
        """Return the sums after one more step."""
        losses = dict(self.losses)
        for name, value in step.losses.items():
            total, count = losses.get(name, (0.0, 0))
            losses[name] = (total + value, count + 1)
        return Sums(self.steps + 1, self.psnr_db + (step.psnr_db or 0.0), losses)


@dataclass(frozen=True)
class Position:
    """The progress of a run.

    Attributes:
        steps: number of steps.
        shown: number of examples read from a stream, including those that taught nothing.
        spent_s: processor time of the steps.
        wall_s: wall time of the steps.
        reports: number of equal steps of progress that have been reported.
        rows: number of rows of the curves written so far.
        sums: sums over the steps since then.
    """

    steps: int = 0
    shown: int = 0
    spent_s: float = 0.0
    wall_s: float = 0.0
    reports: int = 0
    rows: int = 0
    sums: Sums = Sums()

    def after(self, step: Step, clock: Clock) -> Position:
        """Return the position after one more step."""
        return replace(
            self, steps=self.steps + 1, shown=self.shown + step.shown, spent_s=clock.spent_s, wall_s=clock.wall_s,
            sums=self.sums.after(step),
        )  # fmt: skip

    def row(self, step: Step, progress: float) -> Row:
        """Return the row of the curves that ends with a step: means since the last row.

        Args:
            step: the last step.
            progress: from 0 to 1.
        """
        psnr = {} if step.psnr_db is None else {"psnr_db": self.sums.psnr_db / max(self.sums.steps, 1)}
        means = {name: total / count for name, (total, count) in self.sums.losses.items()}
        times = {"core_s": self.spent_s, "wall_s": self.wall_s}
        return {"step": self.steps, "progress": progress, **times, **psnr, **step.sizes, **means}

    def reported(self, reports: int) -> Position:
        """Return the position after a row of the curves."""
        return replace(self, reports=reports, rows=self.rows + 1, sums=Sums())


class CheckpointPosition(RootModel[Position]):
    """The progress of a run as JSON, in a checkpoint."""
