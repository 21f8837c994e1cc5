"""What the benchmark of static reconstruction does, a function a verb."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Final

from benchmarks.studies.static_reconstruction.arguments import Arguments
from benchmarks.studies.static_reconstruction.data import prepare, require_prepared
from benchmarks.studies.static_reconstruction.declared import Declared, Tuning
from benchmarks.studies.static_reconstruction.groups import COMPARISON, TUNING, Group, asked, groups, split_of
from benchmarks.studies.static_reconstruction.job import OUTCOMES, TRUTH, Job, read_ceilings, read_outcome
from benchmarks.studies.static_reconstruction.queue import run_all
from benchmarks.studies.static_reconstruction.settings import settings_tables
from benchmarks.studies.static_reconstruction.tables import chosen, differences, outcomes, tables, tuned
from mirror.errors import DatasetError, ExitCode
from mirror.progress import progress_bar
from mirror.schema.files import write_bytes

_COMPARED: Final = ("train PSNR", "train SSIM", "train ST-LPIPS", "novel PSNR*", "novel SSIM", "novel ST-LPIPS")


def _tune(arguments: Arguments, declaration: Declared) -> int:
    """Make the street of the trials, run those that are not done, and show all."""
    grid, folder = declaration.tuning, arguments.data / TUNING
    group = asked(arguments, declaration, TUNING)
    with progress_bar(quiet=False) as watch:
        street = replace(declaration, preset=grid.preset, scenes_seed=grid.seed)
        prepare(folder, street, group.scenes, [declaration.split], group.width_px, watch)
    failed = run_all(group.jobs, folder, arguments.jobs)
    print(_trials(folder, group, grid))
    return ExitCode.PARTLY_DONE if failed else ExitCode.DONE


def _trials(folder: Path, group: Group, grid: Tuning) -> str:
    parts = []
    for minutes in group.minutes:
        own = [one for one in outcomes(folder) if replace(group, minutes=(minutes,)).has(one.job)]
        if own:
            what = "training PSNR / PSNR* of the held-out traversal, dB; the best sum of a method is bold"
            parts.append(f"tuning, {minutes:g} core-minutes: {what}\n\n{tuned(own, grid)}")
            if text := chosen(own):
                what = "one of the tuned settings changed, for rivals back to what was released, dB"
                parts.append(f"choices, {minutes:g} core-minutes: {what}\n\n{text}")
    return "\n\n".join(parts)


def _prepare(arguments: Arguments, declaration: Declared) -> int:
    group = asked(arguments, declaration)
    splits = dict.fromkeys(split_of(row, declaration) for row in group.rows)
    with progress_bar(quiet=False) as watch:
        prepare(arguments.data, declaration, group.scenes, list(splits), group.width_px, watch)
    return ExitCode.DONE


def _run(arguments: Arguments, declaration: Declared) -> int:
    group = asked(arguments, declaration)
    splits = list(dict.fromkeys(split_of(row, declaration) for row in group.rows))
    require_prepared(arguments.data, declaration, group.scenes, splits, group.width_px)
    return ExitCode.PARTLY_DONE if run_all(group.jobs, arguments.data, arguments.jobs) else ExitCode.DONE


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
    for path in read_ceilings(arguments.data):
        write_bytes(arguments.out / TRUTH / path.name, path.read_bytes())
    print(arguments.out)
    return ExitCode.DONE


def _show(arguments: Arguments, declaration: Declared) -> int:
    group = asked(arguments, declaration)
    found = [one for one in outcomes(arguments.data) if group.has(one.job)]
    if not found:
        raise _nothing(arguments, "outcome")
    print(f"declaration {declaration.hash[:16]}")
    for minutes in group.minutes:
        own = [one for one in found if one.job.core_minutes == minutes]
        print(f"\n{minutes:g} core-minutes a block, {group.width_px} px")
        for text in tables(own, group.shown):
            print(f"\n{text}")
        for row in group.against:
            if text := differences(own, row, group.shown, _COMPARED):
                print(f"\n{text}")
    if trials := _trials(arguments.data / TUNING, groups(declaration)[TUNING], declaration.tuning):
        print(f"\n{trials}")
    return ExitCode.DONE


def _nothing(arguments: Arguments, what: str) -> DatasetError:
    remedy = f"`prepare` and `run` with --data {arguments.data}; what is published is in docs/results"
    return DatasetError(f"no {what} of group {arguments.group}", file=arguments.data, remedy=remedy)


def _settings(arguments: Arguments, declaration: Declared) -> int:
    print("\n\n".join(settings_tables(asked(arguments, declaration).shown)))
    return ExitCode.DONE


def _truth(arguments: Arguments, declaration: Declared) -> int:
    # It takes what no table of outcomes needs: the street is built again.
    from benchmarks.studies.static_reconstruction.truth.run import measure, measure_ceiling, measured
    from benchmarks.studies.static_reconstruction.truth.tables import ceiling_table
    from benchmarks.studies.static_reconstruction.truth.tables import tables as truth_tables
    from benchmarks.studies.static_reconstruction.truth.trained import done_jobs

    group = asked(arguments, declaration)
    trained = [job for job in done_jobs(arguments.data) if group.has(job)]
    for scene in dict.fromkeys(job.scene for job in trained):
        measure_ceiling(scene, group.width_px, arguments.data)
    for job in trained:
        measure(job, arguments.data)
    found = [one for one in measured(arguments.data) if group.has(Job(**one["job"]))]
    found.sort(key=lambda one: group.shown.index(one["job"]["entry"]))
    for minutes in group.minutes:
        if own := [one for one in found if one["job"]["core_minutes"] == minutes]:
            print(f"{minutes:g} core-minutes a block, {group.width_px} px\n\n{truth_tables(own)}")
    if not found:
        raise _nothing(arguments, "measured model")
    exact = [one for one in read_ceilings(arguments.data).values() if one["width_px"] == group.width_px]
    if text := ceiling_table([one for one in exact if one["scene"] in group.scenes]):
        print(f"\n### What the exact street scores\n\n{text}")
    return ExitCode.DONE


def _figures(arguments: Arguments, declaration: Declared) -> int:
    from benchmarks.studies.static_reconstruction.figures import write_budgets, write_sheet
    from benchmarks.studies.static_reconstruction.truth.trained import done_jobs

    group = asked(arguments, declaration)
    group = replace(group, seeds=group.seeds[:1])
    trained = [job for job in done_jobs(arguments.data) if group.has(job)]
    if not trained:
        raise _nothing(arguments, "trained model")
    prefix = "" if arguments.group == COMPARISON else f"{arguments.group}-"
    for scene, minutes in product(group.scenes, group.minutes):
        own = [job for job in trained if (job.scene, job.core_minutes) == (scene, minutes)]
        own.sort(key=lambda job: group.shown.index(job.entry))
        if own:
            suffix = "" if len(group.minutes) == 1 else f"-{minutes:g}min"
            write_sheet(own, arguments.data, arguments.out / f"{prefix}{scene}{suffix}.jpg")
    if len(group.minutes) > 1:
        found = [one for one in outcomes(arguments.data) if group.has(one.job)]
        write_budgets(found, group.shown, arguments.out / f"{arguments.group}.png")
    print(arguments.out)
    return ExitCode.DONE


VERBS: Final[Mapping[str, Callable[[Arguments, Declared], int]]] = {
    "tune": _tune,
    "prepare": _prepare,
    "run": _run,
    "show": _show,
    "settings": _settings,
    "publish": _publish,
    "truth": _truth,
    "figures": _figures,
}
"""By name."""
