"""Groups of rows that are run and shown together, with the budgets, width, scenes and seeds of each group."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

from benchmarks.studies.static_reconstruction.arguments import Arguments, GroupName
from benchmarks.studies.static_reconstruction.choices import baseline_name, choice
from benchmarks.studies.static_reconstruction.declaration import Declaration
from benchmarks.studies.static_reconstruction.jobs import Job
from benchmarks.studies.static_reconstruction.methods import (
    BASELINES,
    EQUAL_BYTES_EXPOSED,
    OURS,
    OURS_REPEATED,
    SINGLE,
    STRUCTURE,
    entries,
    trials,
)
from benchmarks.studies.static_reconstruction.records import TUNING
from mirror.errors import UsageError

Name: TypeAlias = Literal[GroupName, "tuning"]

COMPARISON: Final = "comparison"


def _named(pattern: str) -> tuple[str, ...]:
    """Rows of all baselines."""
    return tuple(pattern.format(baseline_name(package)) for package in BASELINES)


_TUNED: Final = _named("{}-tuned")
_MTGS: Final = "mtgs_style-tuned"
_EXPOSED: Final = choice("mtgs_style", "exposure")
"""MTGS-style with an exposure for each training image, as released; its trial was better than the tuned settings."""
_LEAST_MINUTES: Final = 0.01
_LEAST_PX: Final = 16


@dataclass(frozen=True)
class Group:
    """Rows that are run and shown together.

    Attributes:
        rows: names of entries.
        beside: rows of the comparison that are shown with them.
        against: rows whose differences to all others are shown.
        minutes: core-minutes of training of a block.
        width_px: of the images.
        scenes: to train on.
        seeds: of the training.
    """

    rows: tuple[str, ...]
    beside: tuple[str, ...]
    against: tuple[str, ...]
    minutes: tuple[float, ...]
    width_px: int
    scenes: tuple[str, ...]
    seeds: tuple[int, ...]

    @property
    def shown(self) -> list[str]:
        """Rows of the group and the rows beside them, each once."""
        return list(dict.fromkeys([*self.beside, *self.rows]))

    @property
    def jobs(self) -> list[Job]:
        """Jobs seed by seed and scene by scene, so that compared rows are trained within the same hour."""
        return [
            Job(entry, scene, seed, minutes, self.width_px)
            for seed in self.seeds for minutes in self.minutes for scene in self.scenes for entry in self.rows
        ]  # fmt: skip

    def has(self, job: Job) -> bool:
        """Return whether a job is shown in the group."""
        own = job.core_minutes in self.minutes and job.width_px == self.width_px
        return own and job.entry in self.shown and job.scene in self.scenes and job.seed in self.seeds


def groups(declaration: Declaration) -> Mapping[Name, Group]:
    """Return all groups, by name."""
    tuned = (OURS, _MTGS, STRUCTURE, *(name for name in _TUNED if name != _MTGS))
    whole = Group(
        rows=(*tuned, _EXPOSED, SINGLE),
        beside=(OURS, STRUCTURE),
        against=(OURS, STRUCTURE),
        minutes=(declaration.core_minutes,),
        width_px=declaration.width_px,
        scenes=declaration.scenes,
        seeds=declaration.seeds,
    )
    once = replace(whole, seeds=declaration.seeds[:1])
    one_block = replace(once, scenes=declaration.scenes[:1])
    grid = declaration.tuning
    return {
        COMPARISON: whole,
        "bytes": replace(
            whole, rows=(*(f"{baseline_name(package)}-bytes" for package in BASELINES), EQUAL_BYTES_EXPOSED)
        ),
        "released": replace(once, rows=_named("{}-released")),
        "ablation": replace(
            once,
            rows=(
                OURS_REPEATED,
                "no-appearance",
                "no-anchors",
                "no-depth",
                "no-normals",
                "2-traversals",
                "1-traversals",
                SINGLE,
            ),
            beside=(),
            against=(OURS_REPEATED,),
        ),
        "seam": replace(once, rows=("two-blocks",), beside=(OURS,), against=(OURS,)),
        "budgets": replace(one_block, rows=tuned, minutes=declaration.core_minutes_curve),
        "long": replace(
            one_block,
            rows=(OURS, _MTGS, STRUCTURE),
            minutes=(declaration.core_minutes_long,),
            width_px=declaration.width_long_px,
        ),
        TUNING: replace(
            once, rows=tuple(trials()), beside=(), against=(), minutes=(grid.core_minutes,), scenes=(grid.scene,)
        ),
    }


def split_of(row: str, declaration: Declaration) -> str:
    """Return the split that a row is trained on."""
    return entries()[row].split or declaration.split


def select_group(arguments: Arguments, declaration: Declaration, name: Name | None = None) -> Group:
    """Select the group that arguments name, or `name`.

    The arguments replace its entries, scenes, seeds and so on.

    Raises:
        UsageError: an unknown row or scene, or a budget, width or seed that is too small.
    """
    group = groups(declaration)[name or arguments.group]
    scenes = {*declaration.scenes, declaration.tuning.scene}
    for option, words, known in (
        ("--entries", arguments.entries, set(entries())),
        ("--scenes", arguments.scenes, scenes),
    ):
        for word in words:
            if word not in known:
                near = difflib.get_close_matches(word, sorted(known), 3)
                raise UsageError(f"no {word!r}", place=option, expected=" or ".join(near or sorted(known)[:9]))
    for option, numbers, least in (
        ("--minutes", arguments.minutes, _LEAST_MINUTES),
        ("--width", () if arguments.width is None else (arguments.width,), _LEAST_PX),
        ("--seeds", arguments.seeds, 0),
    ):
        if wrong := [number for number in numbers if not number >= least]:
            raise UsageError(f"{wrong[0]:g}", place=option, expected=f"{least:g} or more")
    return replace(
        group,
        rows=arguments.entries or group.rows,
        minutes=arguments.minutes or group.minutes,
        width_px=arguments.width or group.width_px,
        scenes=arguments.scenes or group.scenes,
        seeds=arguments.seeds or group.seeds,
    )
