"""Generates traffic over the synthetic street and measures it: conditioning, vehicles, edits, identity, steps."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from mirror.errors import ExitCode


@dataclass(frozen=True)
class Arguments:
    """The study that `experiment.toml` declares. Every stage resumes where it was interrupted.

    list: the stages with their budgets. run: the stages that are not finished. report: the tables of
    report.md and sheets of images. publish: the figures of finished stages into outcomes.jsonl, so that the
    report shows them without the folder. crops: the distance of crops by class and drive. fid: FID and FVD of finished
    rollouts, where their weights are there. clips, judges: these stages alone; clips --map: clips with the lines of the
    map in the folder clips-with-maps, which are no part of the study. end-to-end: the addition that `end_to_end.toml`
    declares, once the clips, the judges and its model are there; publish and report show it too.
    """

    what: tyro.conf.Positional[
        Literal["list", "run", "report", "publish", "crops", "fid", "clips", "judges", "end-to-end"]
    ]
    """What to do."""
    out: Path = Path("benchmarks/out/generation")
    """Folder of the study."""
    stage: str | None = None
    """Run this stage alone, so that a queue can take one stage after another."""
    hours: float | None = None
    """Core-hours after which no stage is begun. None: the declaration's."""
    map: bool = False
    """Of clips: make clips with the lines of the map, for `mirror generate train --map`."""
    check: bool = False
    """Of report: change nothing, and fail if report.md has other tables."""


def main(argv: Sequence[str]) -> int:
    """Run the study, or a part of it."""
    arguments = tyro.cli(Arguments, args=list(argv), prog="python -m benchmarks generation")

    from benchmarks.studies.generation import crops, published
    from benchmarks.studies.generation.declaration import load_declaration
    from benchmarks.studies.generation.end_to_end import list_parts, list_roads, load_addition, open_addition
    from benchmarks.studies.generation.make_clips import make_clips
    from benchmarks.studies.generation.report import PAGE, format_report, update_page
    from benchmarks.studies.generation.sheets import write_sheets
    from benchmarks.studies.generation.stages import list_stages
    from benchmarks.studies.generation.study import Study, run_stages
    from benchmarks.studies.stages import describe_stages
    from mirror.progress import progress_bar

    study = Study(arguments.out, load_declaration(), make_clips)
    declared = load_addition()
    addition = open_addition(study, declared)
    print(f"declaration {study.declaration.hash}")
    if arguments.what == "list":
        stages = list_stages(study.declaration)
        print("\n".join(describe_stages((stage, study.figures(stage.name) is not None) for stage in stages)))
        return ExitCode.DONE
    if arguments.what == "report":
        text = format_report(study, addition)
        if arguments.check:
            return ExitCode.DONE if text in PAGE.read_text() else ExitCode.FINDINGS
        update_page(study, addition=addition)
        print(text)
        if study.figures("clips") is not None:
            print("\n".join(map(str, write_sheets(study, study.folder / "sheets"))))
        if addition.figures("render") is not None:
            print("\n".join(map(str, write_sheets(addition, addition.folder / "sheets"))))
        return ExitCode.DONE
    if arguments.what in ("crops", "fid"):
        begin = time.process_time()
        if arguments.what == "crops":
            stage, figures = crops.STAGE, crops.measure_crops(study)
        else:
            stage, figures = published.STAGE, published.measure_published(study, *published.load_networks())
        study.finish(stage, time.process_time() - begin, figures)
        print(json.dumps(figures, indent=1))
        return ExitCode.DONE
    if arguments.what == "publish":
        print(study.publish())
        if addition.outcomes:
            print(addition.publish())
        return ExitCode.DONE
    if arguments.what == "end-to-end":
        print(f"declaration of the addition {declared.hash}")
        parts = list_parts(study, declared, list_roads(declared, addition.folder))
        hours = declared.budget["core_minutes"] / 60.0 if arguments.hours is None else arguments.hours
        with progress_bar(quiet=False) as bar:
            left = run_stages(addition, parts, bar, only=arguments.stage, hours=hours)
        print("\n".join(describe_stages((part, addition.figures(part.name) is not None) for part in parts)))
        return ExitCode.DONE if not left else ExitCode.FINDINGS
    if arguments.what == "clips" and arguments.map:
        folder = arguments.out / "clips-with-maps"
        with progress_bar(quiet=False) as bar:
            clips = make_clips(folder, bar, with_maps=True)
        print(f"{folder}: {len(clips.training)} training clips, {len(clips.test)} test clips")
        print(f"next: mirror generate train {folder} --map --steps 4000 --out generator")
        return ExitCode.DONE
    only = arguments.stage if arguments.what == "run" else arguments.what
    with progress_bar(quiet=False) as bar:
        left = run_stages(study, list_stages(study.declaration), bar, only=only, hours=arguments.hours)
    print(f"{left} stages are left: python -m benchmarks generation list")
    return ExitCode.DONE
