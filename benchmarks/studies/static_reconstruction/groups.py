"""Rows that are run and shown together, and over what: which budgets, widths, scenes and seeds each group has."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Literal, TypeAlias

from benchmarks.studies.static_reconstruction.arguments import Arguments, GroupName
from benchmarks.studies.static_reconstruction.choices import choice, name_of
from benchmarks.studies.static_reconstruction.declared import Declared
from benchmarks.studies.static_reconstruction.job import Job
from benchmarks.studies.static_reconstruction.methods import (
    AGAIN,
    OURS,
    RIVALS,
    SINGLE,
    SMALL_EXPOSED,
    STRUCTURE,
    entries,
    trials,
)
from mirror.errors import UsageError

Name: TypeAlias = Literal[GroupName, "tuning"]

COMPARISON: Final = "comparison"
TUNING: Final = "tuning"
"""Group of the trials, and folder of theirs."""

_TUNED: Final = tuple(f"{name_of(package)}-tuned" for package in RIVALS)
_MTGS: Final = "mtgs_style-tuned"
_EXPOSED: Final = choice("mtgs_style", "exposure")
"""The one choice that MTGS-style is better without: each training picture has its exposure, as released."""
_LEAST_MINUTES: Final = 0.01
_LEAST_PX: Final = 16


@dataclass(frozen=True)
class Group:
    """What is run and shown together.

    Attributes:
        rows: names of entries.
        beside: of the comparison, shown with them.
        against: rows that differences to the others are told of.
        minutes: core-minutes of training of a block.
        width_px: of the pictures.
        scenes: which.
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
        """Rows and what stands beside them, each once."""
        return list(dict.fromkeys([*self.beside, *self.rows]))

    @property
    def jobs(self) -> list[Job]:
        """Seed by seed and scene by scene, so that what is compared is trained within the same hour."""
        return [
            Job(entry, scene, seed, minutes, self.width_px)
            for seed in self.seeds for minutes in self.minutes for scene in self.scenes for entry in self.rows
        ]  # fmt: skip

    def has(self, job: Job) -> bool:
        """Whether a job is shown in the group."""
        own = job.core_minutes in self.minutes and job.width_px == self.width_px
        return own and job.entry in self.shown and job.scene in self.scenes and job.seed in self.seeds


def groups(declaration: Declared) -> Mapping[Name, Group]:
    """All groups, by name."""
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
        "bytes": replace(whole, rows=(*(f"{name_of(package)}-bytes" for package in RIVALS), SMALL_EXPOSED)),
        "released": replace(once, rows=tuple(f"{name_of(package)}-released" for package in RIVALS)),
        "ablation": replace(
            once,
            rows=(
                AGAIN,
                "no-appearance",
                "no-anchors",
                "no-depth",
                "no-normals",
                "2-traversals",
                "1-traversals",
                SINGLE,
            ),
            beside=(),
            against=(AGAIN,),
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


def split_of(row: str, declaration: Declared) -> str:
    """What a row is trained on."""
    return entries()[row].split or declaration.split


def asked(arguments: Arguments, declaration: Declared, name: Name | None = None) -> Group:
    """The group that arguments name, or another, with what they say in place of its own.

    Raises:
        UsageError: a row or a scene that there is not, or no such budget, width or seed.
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
