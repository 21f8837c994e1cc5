"""The reference model on a GPU, offline: checks, depth, rasterizer, frames, training, generation, features, a drive.

``python -m benchmarks gpu`` takes at most four minutes on a GPU, after it has made its street (`benchmarks/out/gpu`;
once, on the CPU's cores); each part states its budget and its seconds. ``--full METHOD`` trains one method for 30,000
steps and continues where an earlier call stopped. Results of a GPU at full size are written to ``docs/gpu`` and into
the table of docs/performance.md. ``--scale 0.01 --device cpu`` walks through everything at a hundredth of the size.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Final

import torch
import tyro

from benchmarks.gpu import table
from benchmarks.gpu.bringing import describe_needs
from benchmarks.gpu.machine import Machine
from benchmarks.gpu.quantities import BUDGETS_S, METHODS, Measurement, PartResult, full_part, list_quantities
from benchmarks.gpu.streets import StreetData, choose_street, make_street
from benchmarks.report import OUT
from mirror.command_line import parse_arguments
from mirror.devices import CPU, OPTION, resolve_device
from mirror.errors import ExitCode, MirrorError, UsageError
from mirror.schema.files import read_json, write_json

_DRY_SCALE: Final = 0.01


@dataclass(frozen=True)
class Arguments:
    """Measure the reference model on a GPU, or walk through the measurement on a CPU at a fraction of the size."""

    device: str = "auto"
    """auto, cpu or cuda[:N]. A CPU needs a --scale below 1."""
    scale: float = 1.0
    """Share of the numbers of Gaussians, pixels and steps. Below 1 nothing is written to docs."""
    only: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = field(default=())
    """A part to measure; may be repeated. Default: all, without trainings of full length."""
    full: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = field(default=())
    """A method to train for 30,000 steps instead; the same call continues it. One method a call is best."""
    data: Path | None = None
    """Folder of the street. Default: benchmarks/out/gpu/PRESET."""
    prepare: bool = False
    """Make the street only, and print what to bring to a machine without a network."""
    table: bool = False
    """Write the table of docs/performance.md from docs/gpu only."""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    arguments = parse_arguments(
        Arguments, argv, "python -m benchmarks gpu",
        examples=("python -m benchmarks gpu", "python -m benchmarks gpu --full mtgs_style",
                  "python -m benchmarks gpu --scale 0.01 --device cpu"),
    )  # fmt: skip
    if arguments.table:
        table.write_table()
        return ExitCode.DONE
    _require_known("--only", arguments.only, tuple(BUDGETS_S))
    _require_known("--full", arguments.full, METHODS)
    if not 0.0 < arguments.scale <= 1.0:
        raise UsageError(f"{arguments.scale:g}", place="--scale", expected="more than 0, and 1 at most")
    device = resolve_device(arguments.device, splats=True)
    print(device, flush=True)
    machine = Machine(device.name, arguments.scale)
    if not machine.is_gpu and arguments.scale == 1.0 and not arguments.prepare:
        raise UsageError(
            "the full size needs a GPU", place=OPTION, expected="a GPU, or --scale below 1",
            remedy=f"--scale {_DRY_SCALE:g} {OPTION} {CPU}",
        )  # fmt: skip
    measured = _measure(machine, arguments)
    if arguments.prepare:
        print(describe_needs(choose_street(machine, arguments.data)))
        return ExitCode.DONE
    if machine.is_gpu and machine.scale == 1.0:
        table.write_table()
        print(f"written: {table.FOLDER / machine.slug}.json, and the table of {table.PAGE}")
    else:
        print(table.make_table([measured]))
    missing = [name for name, part in measured.parts.items() if part.not_measured is not None]
    return ExitCode.PARTLY_DONE if missing else ExitCode.DONE


def _require_known(place: str, names: Sequence[str], known: Sequence[str]) -> None:
    for name in names:
        if name not in known:
            raise UsageError(f"{name!r}", place=place, expected=", ".join(known))


def _measure(machine: Machine, arguments: Arguments) -> Measurement:
    """Measure the chosen parts one after the other; the document is written after each, so that none is lost."""
    path = (
        table.FOLDER / f"{machine.slug}.json"
        if machine.is_gpu and machine.scale == 1.0
        else OUT / "gpu" / f"{machine.slug}-{machine.scale:g}.json"
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    measured = Measurement(device=machine.name, versions=dict(machine.versions()), scale=machine.scale)
    if path.is_file():
        # Parts of an earlier call stay, unless they are measured again.
        measured = measured.model_copy(update={"parts": read_json(path, Measurement).parts})
    street = choose_street(machine, arguments.data)
    if arguments.prepare or arguments.full or not arguments.only or {"train", "loop"} & set(arguments.only):
        begin = time.monotonic()
        make_street(street)
        print(f"street: {street.folder}, {time.monotonic() - begin:.0f} s (no part of the budgets)", flush=True)
    if arguments.prepare:
        return measured
    work = OUT / "gpu" / f"{machine.slug}-{machine.scale:g}"
    for name, measure in _list_parts(machine, arguments, street, work).items():
        print(f"{name}: {_budget(name)}", flush=True)
        begin = time.monotonic()
        try:
            result = measure()
        except (MirrorError, torch.OutOfMemoryError) as error:
            result = PartResult(
                seconds=time.monotonic() - begin, budget_s=BUDGETS_S.get(name, 0.0), not_measured=str(error)
            )
        measured = measured.model_copy(update={"parts": {**measured.parts, name: _explained(name, result, machine)}})
        write_json(path, measured)
        _print(name, measured.parts[name], machine)
    return measured


def _list_parts(
    machine: Machine, arguments: Arguments, street: StreetData, work: Path
) -> Mapping[str, Callable[[], PartResult]]:
    """The chosen parts in their order."""
    from benchmarks.gpu.closed_loop import measure_loop
    from benchmarks.gpu.depth import measure_depth
    from benchmarks.gpu.networks import measure_features, measure_generation
    from benchmarks.gpu.splats import measure_checks, measure_frames, measure_rasterizer
    from benchmarks.gpu.training import measure_step, train_block, train_fully

    if arguments.full:
        return {
            full_part(method): lambda method=method: train_fully(machine, street, method, work)  # type: ignore[misc]
            for method in arguments.full
        }
    simple: Mapping[str, Callable[[Machine], dict[str, float]]] = {
        "checks": measure_checks,
        "depth": measure_depth,
        "rasterizer": measure_rasterizer,
        "frames": measure_frames,
        "step": measure_step,
        "generation": measure_generation,
        "features": measure_features,
        "loop": lambda machine: measure_loop(machine, street, work / "model"),
    }
    parts: dict[str, Callable[[], PartResult]] = {
        name: lambda name=name, measure=measure: _timed(name, lambda: measure(machine))  # type: ignore[misc]
        for name, measure in simple.items()
    }
    parts["train"] = lambda: train_block(machine, street, work)
    return {name: parts[name] for name in BUDGETS_S if not arguments.only or name in arguments.only}


def _timed(name: str, measure: Callable[[], dict[str, float]]) -> PartResult:
    begin = time.monotonic()
    values = measure()
    return PartResult(seconds=time.monotonic() - begin, budget_s=BUDGETS_S[name], values=values)


def _explained(name: str, result: PartResult, machine: Machine) -> PartResult:
    """The result, with a reason for each quantity that it lacks."""
    asked = [quantity.name for quantity in list_quantities() if quantity.part == name]
    absent = [one for one in asked if one not in result.values]
    if not absent or result.not_measured is not None:
        return result
    if name.startswith("full "):
        return result.model_copy(update={"note": f"{result.note}; never reached: {', '.join(absent)}"})
    why = "gsplat needs a GPU" if not machine.is_gpu else "no figure was found"
    return result.model_copy(update={"not_measured": f"{why}: {', '.join(absent)}"})


def _budget(name: str) -> str:
    return f"at most {BUDGETS_S[name]:.0f} s on a GPU" if name in BUDGETS_S else "as long as it takes; it continues"


def _print(name: str, result: PartResult, machine: Machine) -> None:
    for quantity in list_quantities():
        if quantity.part == name and quantity.name in result.values:
            beside = f"   ({quantity.beside})" if quantity.beside else ""
            print(f"  {quantity.name:75} {result.values[quantity.name]:10.4g} {quantity.unit}{beside}")
    if result.not_measured is not None:
        print(f"  not measured: {result.not_measured}")
    if result.note:
        print(f"  {result.note}")
    is_late = machine.is_gpu and 0.0 < result.budget_s < result.seconds
    over = ", OVER ITS BUDGET" if is_late else ""
    print(f"  {result.seconds:.1f} s{over}", flush=True)
