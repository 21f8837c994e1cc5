"""Drives twelve policies in the exact world and in reconstructed ones, and compares the verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import tyro

from mirror.errors import ExitCode

OUTCOMES: Final = Path(__file__).with_name("outcomes.jsonl")


@dataclass(frozen=True)
class Arguments:
    """The study that `experiment.toml` declares. Every stage resumes where it was interrupted.

    list: the stages with their budgets. run: the stages that are not finished. report: the tables of
    report.md. sheets: images of the same drives in all worlds that are made. The records can be committed
    at any time, and the run continues from them on another machine: what is missing there is made again when a
    stage needs it. Processes may run different stages side by side.
    """

    what: tyro.conf.Positional[Literal["list", "run", "report", "sheets"]]
    """What to do."""
    out: Path = Path("benchmarks/out/closed_loop")
    """Folder of what can be made again: recordings, images, networks, models; each declaration has its own in it."""
    outcomes: Path = OUTCOMES
    """File of the records, which are only appended to."""
    stage: str | None = None
    """Run this stage alone, with what it needs."""
    hours: float | None = None
    """Core-hours after which no stage is begun. None: the declaration's."""
    check: bool = False
    """Of report: change nothing, and fail if report.md has other tables."""


def main(argv: Sequence[str]) -> int:
    """Run the study, or a part of it."""
    arguments = tyro.cli(Arguments, args=list(argv), prog="python -m benchmarks closed_loop")

    from benchmarks.studies.closed_loop.declaration import load_declaration
    from benchmarks.studies.closed_loop.records import Records
    from benchmarks.studies.closed_loop.report import PAGE, format_report, update_page
    from benchmarks.studies.closed_loop.stages import is_finished, list_stages, run_stages
    from benchmarks.studies.closed_loop.study import Study
    from benchmarks.studies.stages import describe_stages
    from mirror.progress import progress_bar

    declaration = load_declaration()
    study = Study(arguments.out / declaration.hash[:12], declaration, Records(arguments.outcomes, declaration.hash))
    print(f"declaration {declaration.hash}")
    if arguments.what == "list":
        print("\n".join(describe_stages((stage, is_finished(study, stage)) for stage in list_stages(study))))
        return ExitCode.DONE
    if arguments.what == "report":
        text = format_report(study)
        if arguments.check:
            return ExitCode.DONE if text in PAGE.read_text() else ExitCode.FINDINGS
        update_page(study)
        print(text)
        return ExitCode.DONE
    if arguments.what == "sheets":
        from benchmarks.studies.closed_loop.sheets import write_sheets

        print("\n".join(map(str, write_sheets(study, study.folder / "sheets"))))
        return ExitCode.DONE
    with progress_bar(quiet=False) as bar:
        left = run_stages(study, bar, only=arguments.stage, hours=arguments.hours)
    print(f"{left} stages are left: python -m benchmarks closed_loop list")
    return ExitCode.DONE
