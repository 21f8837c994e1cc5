"""The verbs of the study of static reconstruction, a function each."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Final

from benchmarks.studies.static_reconstruction.arguments import Arguments
from benchmarks.studies.static_reconstruction.declaration import Declaration
from benchmarks.studies.static_reconstruction.groups import COMPARISON, Group, groups, select_group, split_of
from benchmarks.studies.static_reconstruction.jobs import Job
from benchmarks.studies.static_reconstruction.queue import run_all
from benchmarks.studies.static_reconstruction.records import TUNING, Records, publish, read_records, read_trials
from benchmarks.studies.static_reconstruction.report import group_tables, write_report
from benchmarks.studies.static_reconstruction.scenes import prepare, require_prepared
from benchmarks.studies.static_reconstruction.settings import settings_tables
from benchmarks.studies.static_reconstruction.tables import JobResult, read_results
from benchmarks.studies.static_reconstruction.tuning_tables import choices_table, grid_table
from mirror.errors import DatasetError, ExitCode
from mirror.progress import progress_bar


def _tune(arguments: Arguments, declaration: Declaration) -> int:
    """Make the street of the trials, run those that are not done, and show all."""
    grid, folder = declaration.tuning, arguments.data / TUNING
    group = select_group(arguments, declaration, TUNING)
    with progress_bar(quiet=False) as progress:
        street = replace(declaration, preset=grid.preset, scenes_seed=grid.seed)
        prepare(folder, street, group.scenes, [declaration.split], group.width_px, progress)
    failed = run_all(group.jobs, folder, arguments.jobs)
    print(_show_trials(read_results(read_trials(arguments.data).outcomes), group, declaration))
    return ExitCode.PARTLY_DONE if failed else ExitCode.DONE


def _show_trials(trials: Sequence[JobResult], group: Group, declaration: Declaration) -> str:
    parts = []
    for minutes in group.minutes:
        own = [one for one in trials if replace(group, minutes=(minutes,)).has(one.job)]
        if own:
            what = "training PSNR / PSNR* of the held-out traversal, dB; the best sum of a method is bold"
            parts.append(f"tuning, {minutes:g} core-minutes: {what}\n\n{grid_table(own, declaration.tuning)}")
            if text := choices_table(own):
                what = "one of the tuned settings changed, for baselines back to what was released, dB"
                parts.append(f"choices, {minutes:g} core-minutes: {what}\n\n{text}")
    return "\n\n".join(parts)


def _prepare(arguments: Arguments, declaration: Declaration) -> int:
    group = select_group(arguments, declaration)
    splits = dict.fromkeys(split_of(row, declaration) for row in group.rows)
    with progress_bar(quiet=False) as progress:
        prepare(arguments.data, declaration, group.scenes, list(splits), group.width_px, progress)
    return ExitCode.DONE


def _run(arguments: Arguments, declaration: Declaration) -> int:
    group = select_group(arguments, declaration)
    splits = list(dict.fromkeys(split_of(row, declaration) for row in group.rows))
    require_prepared(arguments.data, declaration, group.scenes, splits, group.width_px)
    return ExitCode.PARTLY_DONE if run_all(group.jobs, arguments.data, arguments.jobs) else ExitCode.DONE


def _publish(arguments: Arguments, declaration: Declaration) -> int:
    publish(arguments.data, arguments.outcomes, arguments.campaign)
    print(arguments.outcomes)
    return ExitCode.DONE


def _show(arguments: Arguments, declaration: Declaration) -> int:
    group = select_group(arguments, declaration)
    results = [one for one in read_results(_records(arguments).outcomes) if group.has(one.job)]
    if not results:
        raise _nothing(arguments, "outcome")
    print(f"declaration {declaration.hash[:16]}")
    for minutes in group.minutes:
        print(f"\n{minutes:g} core-minutes a block, {group.width_px} px")
        for text in group_tables(results, group, minutes):
            print(f"\n{text}")
    trials = read_results(read_trials(arguments.source).outcomes) if arguments.campaign == "main" else []
    if text := _show_trials(trials, groups(declaration)[TUNING], declaration):
        print(f"\n{text}")
    return ExitCode.DONE


def _records(arguments: Arguments) -> Records:
    return read_records(arguments.source, arguments.campaign)


def _nothing(arguments: Arguments, what: str) -> DatasetError:
    remedy = f"`prepare` and `run` with --data {arguments.data}; --published shows the published records"
    return DatasetError(f"no {what} of group {arguments.group}", file=arguments.source, remedy=remedy)


def _settings(arguments: Arguments, declaration: Declaration) -> int:
    print("\n\n".join(settings_tables(select_group(arguments, declaration).shown)))
    return ExitCode.DONE


def _truth(arguments: Arguments, declaration: Declaration) -> int:
    from benchmarks.studies.static_reconstruction.truth.tables import all_tables, exact_street_table, select_truth

    group = select_group(arguments, declaration)
    if not arguments.published:
        _measure(arguments, group)
    records = _records(arguments)
    found = select_truth(records.truth, group)
    for minutes in group.minutes:
        if own := [one for one in found if one["job"]["core_minutes"] == minutes]:
            print(f"{minutes:g} core-minutes a block, {group.width_px} px\n\n{all_tables(own)}")
    if not found:
        raise _nothing(arguments, "measured model")
    if text := exact_street_table(records.exact_street, group):
        print(f"\n### What the exact street scores\n\n{text}")
    return ExitCode.DONE


def _measure(arguments: Arguments, group: Group) -> None:
    """Measure the trained models of a group, and the exact streets of their scenes."""
    from benchmarks.studies.static_reconstruction.truth.measure import measure, measure_exact_street

    trained = _trained_jobs(arguments, group)
    for scene in dict.fromkeys(job.scene for job in trained):
        measure_exact_street(scene, group.width_px, arguments.data)
    for job in trained:
        measure(job, arguments.data)


def _trained_jobs(arguments: Arguments, group: Group) -> list[Job]:
    from benchmarks.studies.static_reconstruction.truth.trained import done_jobs

    return [job for job in done_jobs(arguments.data) if group.has(job)]


def _figures(arguments: Arguments, declaration: Declaration) -> int:
    from benchmarks.studies.static_reconstruction.figures import write_budgets, write_sheet

    group = select_group(arguments, declaration)
    group = replace(group, seeds=group.seeds[:1])
    several_budgets = len(group.minutes) > 1
    trained = [] if arguments.published else _trained_jobs(arguments, group)
    if not trained and not (arguments.published and several_budgets):
        raise _nothing(arguments, "trained model")
    prefix = "" if arguments.group == COMPARISON else f"{arguments.group}-"
    for scene, minutes in product(group.scenes, group.minutes):
        own = [job for job in trained if (job.scene, job.core_minutes) == (scene, minutes)]
        own.sort(key=lambda job: group.shown.index(job.entry))
        if own:
            suffix = f"-{minutes:g}min" if several_budgets else ""
            write_sheet(own, arguments.data, arguments.images / f"{prefix}{scene}{suffix}.jpg")
    if several_budgets:
        results = [one for one in read_results(_records(arguments).outcomes) if group.has(one.job)]
        write_budgets(results, group.shown, arguments.images / f"{arguments.group}.png")
    print(arguments.images)
    return ExitCode.DONE


def _report(arguments: Arguments, declaration: Declaration) -> int:
    write_report(arguments.out / "report.md", arguments.outcomes)
    print(arguments.out / "report.md")
    return ExitCode.DONE


VERBS: Final[Mapping[str, Callable[[Arguments, Declaration], int]]] = {
    "tune": _tune,
    "prepare": _prepare,
    "run": _run,
    "show": _show,
    "settings": _settings,
    "publish": _publish,
    "truth": _truth,
    "figures": _figures,
    "report": _report,
}
"""By name."""
