"""What the benchmark of static reconstruction may be asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import tyro

from benchmarks.report import OUT

GroupName: TypeAlias = Literal["comparison", "bytes", "released", "ablation", "seam", "budgets", "long"]


@dataclass(frozen=True)
class Arguments:
    """Prepare the scenes, run the jobs, show the tables; each goes on where it was stopped.

    The whole comparison takes hours: ten minutes a job, two jobs side by side on two cores.
    """

    what: tyro.conf.Positional[Literal["tune", "prepare", "run", "show", "settings", "publish", "truth", "figures"]] = (
        "show"
    )
    """tune: the same grid of settings for all methods, on a street of its own; prepare: recordings, dataset, layers;
    run: train and score; show: tables of what is done; settings: all numbers of each row; publish: what the tables are
    made of, without the scores of each picture; truth: hold trained models against exact truth; figures: sheets of
    renders and curves of budgets."""
    data: Path = OUT / "reconstruction"
    """Folder of the scenes and of all that is made of them."""
    entries: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Rows, such as ours or mtgs_style-tuned; may be repeated. Default: all of the group."""
    group: GroupName = "comparison"
    """comparison: methods against each other; bytes: rivals with as many bytes as ours; released: rivals as published;
    ablation: ours with parts switched off or fewer traversals, and OmniRe-style on one; seam: ours in two blocks;
    budgets: 2, 10 and 30 core-minutes; long: 30 core-minutes of pictures twice as wide."""
    minutes: Annotated[tuple[float, ...], tyro.conf.UseAppendAction] = ()
    """Core-minutes of training, in place of the group's."""
    scenes: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """In place of the group's."""
    seeds: Annotated[tuple[int, ...], tyro.conf.UseAppendAction] = ()
    """In place of the group's."""
    width: int | None = None
    """Of the pictures, in place of the group's."""
    jobs: int = 2
    """Side by side, each on one core."""
    out: Path = Path("docs/results")
    """Folder of what is published: outcomes and figures."""
