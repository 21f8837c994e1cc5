"""A training step and its parts, a short training with its curve, and trainings of full length."""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from itertools import count
from pathlib import Path
from typing import Any, Final

import torch

from benchmarks.gpu.machine import Machine, Stopwatch
from benchmarks.gpu.quantities import BUDGETS_S, LEVELS_DB, PartResult, full_part
from benchmarks.gpu.splats import front_view, random_image, random_street
from benchmarks.gpu.streets import LAYERS, SPLIT, StreetData, read_training, run_mirror
from hybridworldsim.model import street as street_module
from hybridworldsim.model.dense_adam import DenseAdam
from hybridworldsim.model.lazy_adam import LazyAdam
from hybridworldsim.model.settings import AnchorRefinement, Settings
from hybridworldsim.model.street import StreetModel
from hybridworldsim.model.trainer import StreetTrainer
from hybridworldsim.training.run.curves import Row

STEPS: Final = 7_000
FULL_STEPS: Final = 30_000
_GAUSSIANS: Final = 1_000_000
_TIMED: Final = 20
_RASTERIZE: Final = "rasterization"
_RASTERIZED: Final = ("means", "quats", "scales", "opacities", "colors")


def measure_step(machine: Machine) -> dict[str, float]:
    """Time a step on a street with a million Gaussians, its parts, and the rasterizer alone with the same input."""
    width, height = machine.size_px()
    street = random_street(machine.count(_GAUSSIANS, 600))
    # Statistics are collected, and no refinement falls into the measurement.
    settings = Settings(refinement=AnchorRefinement(begin=0.0, end=1.0, times=1))
    trainer = StreetTrainer(street, settings).to(machine.device)
    shown = [random_image(front_view(width, height), seed).to(torch.device(machine.device)) for seed in range(2)]
    numbers, calls = count(), []

    def step() -> None:
        trainer.step(shown[next(numbers) % len(shown)], 0.5 / STEPS)

    total_ms = machine.median_ms(step, 0.4 * BUDGETS_S["step"])
    called = getattr(street_module, _RASTERIZE)

    def recorded(*args: Any, **options: Any) -> Any:
        calls.append((args, options))
        return called(*args, **options)

    stopwatch = Stopwatch(machine)
    adam = LazyAdam if isinstance(trainer._tables[0], LazyAdam) else DenseAdam
    setattr(street_module, _RASTERIZE, recorded)
    try:
        with stopwatch.watching(
            {
                "decoding": (StreetModel, "decode"),
                "rasterizer, forward": (street_module, _RASTERIZE),
                "losses": (StreetTrainer, "_losses"),
                "backward": (torch.Tensor, "backward"),
                "optimisers": (adam, "end_step"),
                "statistics of refinement": (StreetTrainer, "_refine"),
            }
        ):
            for _ in range(_TIMED):
                step()
    finally:
        setattr(street_module, _RASTERIZE, called)
    parts = {f"- {name}": total / _TIMED for name, total in stopwatch.total_ms.items()}
    alone_ms = _rasterizer_alone_ms(machine, *calls[-1])
    return {
        "a training step, 960x540": total_ms,
        **parts,
        "rasterizer alone, forward and backward": alone_ms,
        "overhead over the rasterizer alone": 100.0 * (total_ms / alone_ms - 1.0),
    }


def _rasterizer_alone_ms(machine: Machine, args: tuple[Any, ...], options: dict[str, Any]) -> float:
    """The time of the rasterizer's own forward and backward pass with the input of a step; on a GPU, of gsplat."""
    tables = [one.detach() for one in args[: len(_RASTERIZED)]]
    rest = args[len(_RASTERIZED) :]
    if machine.is_gpu:
        import gsplat

        called = gsplat.rasterization
        options = {key: value for key, value in options.items() if key not in ("preset", "nonfinite")}
    else:
        called = getattr(street_module, _RASTERIZE)

    def both() -> None:
        leaves = [one.clone().requires_grad_() for one in tables]
        images, alphas, _ = called(*leaves, *rest, **options)
        (images.mean() + alphas.mean()).backward()

    return machine.median_ms(both, 0.2 * BUDGETS_S["step"])


def train_block(machine: Machine, street: StreetData, out: Path) -> PartResult:
    """Train the block for 7,000 steps, by `mirror reconstruct` in a process of its own, as a user does."""
    model, budget_s, begin = out / "model", BUDGETS_S["train"], time.monotonic()
    # The start of the process is in the time, that of an earlier call is not.
    shutil.rmtree(model, ignore_errors=True)
    steps = machine.count(STEPS, 20)
    spent_s = run_mirror(_words(machine, street, model, steps), budget_s if machine.scale == 1.0 else None)
    rows = read_training(model)
    result = PartResult(
        seconds=time.monotonic() - begin, budget_s=budget_s, curve=_curve(rows),
        note=f"hybridworldsim, {steps} steps",
    )  # fmt: skip
    if not rows or spent_s is None:
        last = f" after step {rows[-1]['step']:.0f}" if rows else ""
        return result.model_copy(update={"not_measured": f"interrupted after {budget_s:.0f} s{last}"})
    values = {
        "7,000 steps of a block, 960 px": rows[-1]["wall_s"],
        "PSNR of training images then": rows[-1]["psnr_db"],
        "Gaussians then": rows[-1]["gaussians"],
    }
    return result.model_copy(update={"values": values})


def train_fully(machine: Machine, street: StreetData, method: str, out: Path) -> PartResult:
    """Train a method for 30,000 steps; the same call continues an interrupted run."""
    model, begin = out / "full" / method, time.monotonic()
    steps = machine.count(FULL_STEPS, 20)
    run_mirror([*_words(machine, street, model, steps), "--method", method])
    rows = read_training(model)
    values = {"30,000 steps": rows[-1]["wall_s"] / 60.0, "PSNR of training images then": rows[-1]["psnr_db"]}
    for level in LEVELS_DB:
        reached = reached_s(rows, level)
        if reached is not None:
            values[f"time to {level} dB"] = reached / 60.0
    return PartResult(
        seconds=time.monotonic() - begin, budget_s=0.0, curve=_curve(rows), values=values,
        note=f"{full_part(method)}, {steps} steps",
    )  # fmt: skip


def reached_s(rows: Sequence[Row], level_db: float) -> float | None:
    """Return the seconds of training after which the PSNR of training images first reaches a level; None: never.

    It is interpolated between the rows of the curve, each of which is a mean since the row before.
    """
    before: Row | None = None
    for row in rows:
        if row["psnr_db"] >= level_db:
            if before is None:
                return row["wall_s"]
            share = (level_db - before["psnr_db"]) / (row["psnr_db"] - before["psnr_db"])
            return before["wall_s"] + share * (row["wall_s"] - before["wall_s"])
        before = row
    return None


def _words(machine: Machine, street: StreetData, model: Path, steps: int) -> list[str]:
    width_px = machine.size_px()[0]
    return [
        "reconstruct", str(street.dataset), "--split", SPLIT, "--initialise", LAYERS, "--steps", str(steps),
        "--width", str(width_px), "--device", machine.device, "--out", str(model),
    ]  # fmt: skip


def _curve(rows: Sequence[Row]) -> list[tuple[float, int, float]]:
    return [(round(row["wall_s"], 3), int(row["step"]), round(row["psnr_db"], 3)) for row in rows]
