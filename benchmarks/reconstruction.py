"""Static reconstruction: ours against vanilla 3DGS, MTGS-style and OmniRe-style, at equal cost, on declared scenes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from benchmarks.report import OUT
from mirror.errors import ExitCode

if TYPE_CHECKING:
    from benchmarks._reconstruction.job import Job

_COMPARED = ("train PSNR", "train SSIM", "train ST-LPIPS", "novel PSNR*", "novel SSIM", "novel ST-LPIPS")


@dataclass(frozen=True)
class Arguments:
    """Prepare the scenes, run the jobs, show the tables; each goes on where it was stopped.

    The whole comparison takes hours: ten minutes a job, two jobs side by side on two cores.
    """

    what: tyro.conf.Positional[Literal["tune", "prepare", "run", "show", "truth"]] = "show"
    """tune: the same grid of settings for all methods, on a street of its own; prepare: recordings, dataset, layers;
    run: train and score; show: tables of what is done; truth: hold trained models against exact truth."""
    data: Path = OUT / "reconstruction"
    """Folder of the scenes and of all that is made of them."""
    entries: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Rows, such as ours or mtgs_style-tuned; may be repeated. Default: all of the group."""
    group: Literal["comparison", "bytes", "ablation", "seam"] = "comparison"
    """Methods against each other, rivals with as many bytes as ours, ours with parts switched off, or in two blocks."""
    minutes: Annotated[tuple[float, ...], tyro.conf.UseAppendAction] = ()
    """Core-minutes of training. Default: as declared."""
    scenes: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Default: all that are declared."""
    seeds: Annotated[tuple[int, ...], tyro.conf.UseAppendAction] = ()
    """Default: all that are declared."""
    width: int | None = None
    """Of the pictures. Default: as declared."""
    jobs: int = 2
    """Side by side, each on one core."""


def main(argv: Sequence[str]) -> int:
    """Run the benchmark."""
    arguments = tyro.cli(Arguments, args=list(argv), prog="python -m benchmarks reconstruction")

    from benchmarks._reconstruction.data import prepare
    from benchmarks._reconstruction.declared import declared
    from benchmarks._reconstruction.job import Job
    from benchmarks._reconstruction.methods import OURS, entries
    from benchmarks._reconstruction.queue import run_all
    from benchmarks._reconstruction.tables import differences, outcomes, table
    from mirror.cli.watch import watching

    declaration = declared()
    if arguments.what == "tune":
        return _tune(arguments)
    rows = [
        name
        for name, entry in entries().items()
        if name in arguments.entries or (not arguments.entries and entry.group == arguments.group)
    ]
    width = arguments.width or declaration.width_px
    scenes = arguments.scenes or declaration.scenes
    if arguments.what == "prepare":
        splits = dict.fromkeys(entries()[row].split or declaration.split for row in rows)
        with watching(quiet=False) as watch:
            prepare(arguments.data, declaration, scenes, list(splits), width, watch)
        return ExitCode.DONE
    budgets = arguments.minutes or (declaration.core_minutes,)
    if arguments.what == "run":
        jobs = [
            Job(entry, scene, seed, minutes, width)
            for seed in arguments.seeds or declaration.seeds
            for minutes in budgets
            for scene in scenes
            for entry in rows
        ]
        return ExitCode.PARTLY_DONE if run_all(jobs, arguments.data, arguments.jobs) else ExitCode.DONE
    if arguments.what == "truth":
        # It takes what no table of outcomes needs: the street is built again.
        from benchmarks._reconstruction.truth.run import measure_all
        from benchmarks._reconstruction.truth.tables import tables
        from benchmarks._reconstruction.truth.trained import done_jobs

        trained = [job for job in done_jobs(arguments.data) if job.entry in rows and _is_meant(job, arguments)]
        print(tables(measure_all(trained, arguments.data)) or "no model is trained to the end")
        return ExitCode.DONE
    found = outcomes(arguments.data)
    rows = list(dict.fromkeys([OURS, *rows]))
    print(f"declaration {declaration.hash[:16]}")
    for minutes in budgets:
        own = [one for one in found if one.core_minutes == minutes and one.width_px == width]
        print(f"\n{minutes:g} core-minutes, {width} px\n\n{table(own, rows)}")
        print(f"\n{differences(own, rows, _COMPARED)}")
    return ExitCode.DONE


def _tune(arguments: Arguments) -> int:
    """Make the street of the trials, run those that are not done, and show all."""
    from benchmarks._reconstruction.data import prepare
    from benchmarks._reconstruction.declared import declared
    from benchmarks._reconstruction.job import Job
    from benchmarks._reconstruction.methods import entries
    from benchmarks._reconstruction.queue import run_all
    from benchmarks._reconstruction.tables import outcomes, tuned
    from mirror.cli.watch import watching

    declaration = declared()
    grid, folder = declaration.tuning, arguments.data / "tuning"
    width = arguments.width or declaration.width_px
    with watching(quiet=False) as watch:
        street = replace(declaration, preset=grid.preset, scenes_seed=grid.seed)
        prepare(folder, street, [grid.scene], [declaration.split], width, watch)
    trials = [name for name, entry in entries().items() if entry.group == "tuning"]
    jobs = [Job(name, grid.scene, declaration.seeds[0], grid.core_minutes, width) for name in trials]
    failed = run_all(jobs, folder, arguments.jobs)
    print(tuned(outcomes(folder), grid))
    return ExitCode.PARTLY_DONE if failed else ExitCode.DONE


def _is_meant(job: Job, arguments: Arguments) -> bool:
    """Whether a trained model is one that the arguments name; those that are not given are for any."""
    asked = (
        (job.core_minutes, arguments.minutes),
        (job.scene, arguments.scenes),
        (job.seed, arguments.seeds),
        (job.width_px, (arguments.width,) if arguments.width else ()),
    )
    return all(not wanted or value in wanted for value, wanted in asked)


if __name__ == "__main__":
    raise SystemExit(main([]))
