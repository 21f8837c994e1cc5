"""The loop of all trainings, with a training of two numbers that is stated here."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import pytest
import torch
from torch import Tensor

from hybridworldsim.training.run.budget import Budget
from hybridworldsim.training.run.curves import read_curves
from hybridworldsim.training.run.document import Computation, begin_run, describe_computation
from hybridworldsim.training.run.folder import RunFolder
from hybridworldsim.training.run.loop import REPORTS, train
from hybridworldsim.training.run.position import Position, Step
from hybridworldsim.training.run.training import Training
from mirror.errors import DatasetError, UsageError
from mirror.progress import NullProgress
from mirror.schema.documents import Document
from mirror.schema.files import read_json
from tests.interruption import interrupt_at_call


class Run(Document):
    seed: int = 0
    threads: int = 1


class Outcome(Document):
    steps: int
    value: float


class Sum:
    """Adds up the numbers of its steps; its state is the sum."""

    def __init__(self, broken_at: int | None = None) -> None:
        self.value, self.numbers = torch.zeros((), dtype=torch.float64), list[int]()
        self._broken_at = broken_at

    def __call__(self, position: Position, progress: float) -> Step:
        self.numbers.append(position.steps)
        self.value += position.steps * (1.0 - progress)
        if position.steps == self._broken_at:
            self.value += torch.inf
        return Step({"loss": 1.0 / (1 + position.steps)})

    def state(self) -> dict[str, Tensor]:
        return {"value": self.value}

    def restore(self, state: Mapping[str, Tensor]) -> None:
        self.value = state["value"].clone()


class Bar(NullProgress):
    """Keeps the length of the bar, its advances and the printed lines."""

    def __init__(self) -> None:
        self.total, self.advances, self.lines = 0, list[int](), list[str]()

    def start(self, phase: str, total: int) -> None:
        self.total = total

    def advance(self, steps: int) -> None:
        self.advances.append(steps)

    def report(self, text: str) -> None:
        self.lines.append(text)


def go(path: Path, trained: Sum, budget: Budget, bar: Bar | None = None, interrupt_at: int = -1) -> Outcome:
    def write(file: Path) -> int:
        return file.write_text(str(float(trained.value)))

    folder = RunFolder(path, Outcome)
    training = Training(
        phase="sum", budget=budget, trained=trained, step=interrupt_at_call(trained, interrupt_at + 1),
        learned=lambda: trained.state().items(), describe=lambda row: f"loss {row['loss']:.3f}", write=write,
        outcome=lambda ending: Outcome(steps=ending.position.steps, value=float(trained.value)),
        remedy="take other numbers",
    )  # fmt: skip
    folder.begin(Run())
    with folder.claim(Run()):
        return train(training, folder, bar or Bar())


def test_a_run_that_was_interrupted_makes_each_step_once(tmp_path: Path) -> None:
    first, second, bar = Sum(), Sum(), Bar()
    with pytest.raises(KeyboardInterrupt):
        go(tmp_path / "run", first, Budget(steps=100), interrupt_at=33)
    done = go(tmp_path / "run", second, Budget(steps=100), bar)
    # The step in which Ctrl-C came is finished.
    assert (first.numbers, second.numbers) == (list(range(34)), list(range(34, 100)))
    assert done.steps == 100
    assert done.value == pytest.approx(sum(n * (1 - n / 100) for n in range(100)))
    assert (bar.total, bar.advances[0], sum(bar.advances)) == (100, 34, 100)
    assert float((tmp_path / "run" / "model.safetensors").read_text()) == done.value
    rows = read_curves(tmp_path / "run" / "curves.csv", 1000)
    ends = [-(-100 * part // REPORTS) for part in range(1, REPORTS + 1)]
    assert [row["step"] for row in rows] == ends
    for begin, end, row in zip([0, *ends], ends, rows):
        assert row["loss"] == pytest.approx(sum(1 / (1 + n) for n in range(begin, end)) / (end - begin))


def test_a_budget_of_time_is_counted_in_thousandths(tmp_path: Path) -> None:
    bar = Bar()
    done = go(tmp_path / "run", Sum(), Budget(core_minutes=0.2 / 60.0), bar)
    assert (bar.total, sum(bar.advances)) == (1000, 1000)
    assert done.steps > REPORTS
    rows = read_curves(tmp_path / "run" / "curves.csv", 1000)
    assert rows[-1]["step"] == done.steps
    assert 0.2 <= rows[-1]["core_s"] < 0.3
    line = re.compile(r" *(\d+)%  step \d+  0\.\d\d core-minutes, 0 minutes left  loss 0\.\d{3}")
    shares = [int(found[1]) for text in bar.lines if (found := line.fullmatch(text))]
    assert len(shares) == len(rows)
    assert shares == sorted(shares)
    assert shares[-1] == 100


def test_numbers_that_are_not_finite_leave_the_last_checkpoint(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        go(tmp_path / "run", Sum(), Budget(steps=100), interrupt_at=10)
    before = (tmp_path / "run" / "checkpoint.safetensors").read_bytes()
    with pytest.raises(DatasetError, match=r"value .* at step 2\d"):
        go(tmp_path / "run", Sum(broken_at=20), Budget(steps=100))
    assert (tmp_path / "run" / "checkpoint.safetensors").read_bytes() == before


def test_the_folder_states_the_run_that_learned_something(tmp_path: Path) -> None:
    folder, other = RunFolder(tmp_path / "run", Outcome), Run(seed=1)
    # The first run fails before it learns anything.
    folder.begin(other)
    go(folder.path, Sum(), Budget(steps=3))
    assert read_json(folder.path / "run.json", Run) == Run()
    with pytest.raises(UsageError, match="seed 0, now 1"):
        folder.begin(other)
    assert folder.begin(Run()) == folder.outcome is not None


def test_a_run_continues_on_its_kind_of_device_only(tmp_path: Path) -> None:
    class Numbers(Document):
        threads: int = 1
        computed: Computation | None = None

    on_cpu = Numbers(computed=describe_computation("cpu"))
    gpu = Computation(device="cuda:1", precision="float32", versions={"torch": "2.13.0"})
    begin_run(tmp_path, Numbers(), finished=False, untrained=False)
    begin_run(tmp_path, on_cpu, finished=False, untrained=False)
    with pytest.raises(UsageError, match=r"device cpu, now cuda.*Remedy: --device cpu, or name another folder"):
        begin_run(tmp_path, Numbers(computed=gpu), finished=False, untrained=False)
    begin_run(tmp_path, Numbers(computed=gpu), finished=True, untrained=False)
    (tmp_path / "run.json").unlink()
    begin_run(tmp_path, Numbers(computed=gpu), finished=False, untrained=False)
    other = gpu.model_copy(update={"device": "cuda:0", "versions": {"torch": "2.14.0"}})
    begin_run(tmp_path, Numbers(computed=other), finished=False, untrained=False)
    with pytest.raises(UsageError, match=r"device cuda, now cpu.*--threads 1 --device cuda"):
        begin_run(tmp_path, on_cpu.model_copy(update={"threads": 2}), finished=False, untrained=False)
