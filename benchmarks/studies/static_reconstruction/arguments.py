"""Arguments of the study of static reconstruction."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TypeAlias

import tyro

from benchmarks.report import OUT

STUDY: Path = Path(__file__).parent
GroupName: TypeAlias = Literal["comparison", "bytes", "released", "ablation", "seam", "budgets", "long"]
Verb: TypeAlias = Literal["tune", "prepare", "run", "show", "settings", "publish", "truth", "figures", "report"]
Campaign: TypeAlias = Literal["main", "repeated"]


@dataclass(frozen=True)
class Arguments:
    """Prepare the scenes, run the jobs, show the tables; each verb continues where it was stopped.

    The whole comparison takes hours: ten minutes a job, two jobs side by side on two cores.
    """

    what: tyro.conf.Positional[Verb] = "show"
    """tune: the same grid of settings for all methods, on a street of its own; prepare: recordings, dataset, layers;
    run: train and score; show: tables of finished jobs; settings: all settings of each row; publish: write the records
    into outcomes.jsonl; truth: compare trained models with exact truth; figures: sheets of renders and curves of
    budgets; report: bring the tables of report.md up to date with outcomes.jsonl."""
    data: Path = OUT / "reconstruction"
    """Working folder: scenes, models and one file for each finished job."""
    published: bool = False
    """show, truth and figures read the published outcomes.jsonl in place of the working folder."""
    campaign: Campaign = "main"
    """Of published records. main: the runs of the study; repeated: some of them once more, with scenes and layers made
    again."""
    entries: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """Rows, such as ours or mtgs_style-tuned; may be repeated. Default: all of the group."""
    group: GroupName = "comparison"
    """comparison: methods against each other; bytes: baselines with as many bytes as ours; released: baselines as
    published; ablation: ours with parts switched off or fewer traversals, and OmniRe-style on one; seam: ours in two
    blocks; budgets: 2, 10 and 30 core-minutes; long: 30 core-minutes of images twice as wide."""
    minutes: Annotated[tuple[float, ...], tyro.conf.UseAppendAction] = ()
    """Core-minutes of training, in place of the group's."""
    scenes: Annotated[tuple[str, ...], tyro.conf.UseAppendAction] = ()
    """In place of the group's."""
    seeds: Annotated[tuple[int, ...], tyro.conf.UseAppendAction] = ()
    """In place of the group's."""
    width: int | None = None
    """Of the images, in place of the group's."""
    jobs: int = 2
    """Side by side, each on one core."""
    out: Path = STUDY
    """Folder of the published study: outcomes.jsonl, report.md, images."""

    @property
    def outcomes(self) -> Path:
        """The file of published records."""
        return self.out / "outcomes.jsonl"

    @property
    def images(self) -> Path:
        """The folder of published images."""
        return self.out / "images"

    @property
    def source(self) -> Path:
        """The folder of the records that are read."""
        return self.outcomes if self.published else self.data
