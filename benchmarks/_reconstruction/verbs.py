"""What the benchmark of static reconstruction does, a function a verb."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Final

from benchmarks._reconstruction.arguments import Arguments
from benchmarks._reconstruction.data import prepare
from benchmarks._reconstruction.declared import Declared
from benchmarks._reconstruction.job import OUTCOMES, TRUTH, Job, read_outcome
from benchmarks._reconstruction.methods import OURS, STRUCTURE, entries
from benchmarks._reconstruction.queue import run_all
from benchmarks._reconstruction.tables import differences, outcomes, table, tuned
from mirror.cli.watch import watching
from mirror.errors import ExitCode
from mirror.schema.files import write_bytes

TUNING: Final = "tuning"
"""Group of the trials, and folder of theirs."""

_COMPARED: Final = ("train PSNR", "train SSIM", "train ST-LPIPS", "novel PSNR*", "novel SSIM", "novel ST-LPIPS")


def _rows(arguments: Arguments) -> list[str]:
    """The rows that are asked for."""
    return [
        name
        for name, entry in entries().items()
        if name in arguments.entries or (not arguments.entries and entry.group == arguments.group)
    ]


def _tune(arguments: Arguments, declaration: Declared) -> int:
    """Make the street of the trials, run those that are not done, and show all."""
    grid, folder = declaration.tuning, arguments.data / TUNING
    width = arguments.width or declaration.width_px
    with watching(quiet=False) as watch:
        street = replace(declaration, preset=grid.preset, scenes_seed=grid.seed)
        prepare(folder, street, [grid.scene], [declaration.split], width, watch)
    trials = [
        name for name, entry in entries().items()
        if entry.group == TUNING and (not arguments.entries or name in arguments.entries)
    ]  # fmt: skip
    jobs = [Job(name, grid.scene, declaration.seeds[0], grid.core_minutes, width) for name in trials]
    failed = run_all(jobs, folder, arguments.jobs)
    print(tuned(outcomes(folder), grid))
    return ExitCode.PARTLY_DONE if failed else ExitCode.DONE


def _prepare(arguments: Arguments, declaration: Declared) -> int:
    splits = dict.fromkeys(entries()[row].split or declaration.split for row in _rows(arguments))
    scenes, width = arguments.scenes or declaration.scenes, arguments.width or declaration.width_px
    with watching(quiet=False) as watch:
        prepare(arguments.data, declaration, scenes, list(splits), width, watch)
    return ExitCode.DONE


def _run(arguments: Arguments, declaration: Declared) -> int:
    jobs = [
        Job(entry, scene, seed, minutes, arguments.width or declaration.width_px)
        for seed in arguments.seeds or declaration.seeds
        for minutes in arguments.minutes or (declaration.core_minutes,)
        for scene in arguments.scenes or declaration.scenes
        for entry in _rows(arguments)
    ]
    return ExitCode.PARTLY_DONE if run_all(jobs, arguments.data, arguments.jobs) else ExitCode.DONE


def _publish(arguments: Arguments, declaration: Declared) -> int:
    for folder in (Path(), Path(TUNING)):
        for path in sorted((arguments.data / folder / OUTCOMES).glob("*.json")):
            document = read_outcome(path)
            if document is None:
                continue
            # A thousand pictures each: what all are told by is their means.
            document.pop("scores", None)
            write_bytes(arguments.out / folder / OUTCOMES / path.name, (json.dumps(document) + "\n").encode())
            truth = arguments.data / folder / TRUTH / path.name
            if truth.is_file():
                write_bytes(arguments.out / folder / TRUTH / path.name, truth.read_bytes())
    print(arguments.out)
    return ExitCode.DONE


def _show(arguments: Arguments, declaration: Declared) -> int:
    found = outcomes(arguments.data)
    rows = list(dict.fromkeys([OURS, STRUCTURE, *_rows(arguments)]))
    width = arguments.width or declaration.width_px
    print(f"declaration {declaration.hash[:16]}")
    for minutes in arguments.minutes or (declaration.core_minutes,):
        own = [
            one for one in found
            if (one.core_minutes, one.width_px) == (minutes, width)
            and one.scene in (arguments.scenes or declaration.scenes)
            and one.seed in (arguments.seeds or declaration.seeds)
        ]  # fmt: skip
        print(f"\n{minutes:g} core-minutes, {width} px\n\n{table(own, rows)}")
        for ours in (OURS, STRUCTURE):
            print(f"\n{differences(own, ours, rows, _COMPARED)}")
    if trials := outcomes(arguments.data / TUNING):
        print(f"\ntuning\n\n{tuned(trials, declaration.tuning)}")
    return ExitCode.DONE


def _truth(arguments: Arguments, declaration: Declared) -> int:
    # It takes what no table of outcomes needs: the street is built again.
    from benchmarks._reconstruction.truth.run import measure, measured
    from benchmarks._reconstruction.truth.tables import tables
    from benchmarks._reconstruction.truth.trained import done_jobs

    rows = _rows(arguments)
    for job in done_jobs(arguments.data):
        if job.entry in rows and _is_meant(job, arguments):
            measure(job, arguments.data)
    found = [
        one for one in measured(arguments.data)
        if one["job"]["entry"] in rows and _is_meant(Job(**one["job"]), arguments)
    ]  # fmt: skip
    found.sort(key=lambda one: rows.index(one["job"]["entry"]))
    print(tables(found) or "no model is trained to the end")
    return ExitCode.DONE


def _figures(arguments: Arguments, declaration: Declared) -> int:
    from benchmarks._reconstruction.figures import write_budgets, write_sheet
    from benchmarks._reconstruction.truth.trained import done_jobs

    rows, seed = _rows(arguments), declaration.seeds[0]
    chosen = replace(arguments, minutes=arguments.minutes or (declaration.core_minutes,), seeds=(seed,))
    trained = [job for job in done_jobs(arguments.data) if job.entry in rows and _is_meant(job, chosen)]
    for scene in declaration.scenes:
        own = sorted((job for job in trained if job.scene == scene), key=lambda job: rows.index(job.entry))
        if own:
            write_sheet(own, arguments.data, arguments.out / f"{scene}.jpg")
    width = arguments.width or declaration.width_px
    found = [one for one in outcomes(arguments.data) if (one.seed, one.width_px) == (seed, width)]
    write_budgets(found, rows, arguments.out / "budgets.png")
    print(arguments.out)
    return ExitCode.DONE


def _is_meant(job: Job, arguments: Arguments) -> bool:
    """Whether a trained model is one that the arguments name; those that are not given are for any."""
    asked = (
        (job.core_minutes, arguments.minutes),
        (job.scene, arguments.scenes),
        (job.seed, arguments.seeds),
        (job.width_px, (arguments.width,) if arguments.width else ()),
    )
    return all(not wanted or value in wanted for value, wanted in asked)


VERBS: Final[Mapping[str, Callable[[Arguments, Declared], int]]] = {
    "tune": _tune,
    "prepare": _prepare,
    "run": _run,
    "show": _show,
    "publish": _publish,
    "truth": _truth,
    "figures": _figures,
}
"""By name."""
