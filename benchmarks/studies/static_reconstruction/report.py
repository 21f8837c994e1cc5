"""The tables of the study's report, report.md, which are generated from the published records.

A table stands between ``<!-- begin: COMMAND -->`` and ``<!-- end -->``. A command is one of `TABLES` and its words,
mostly a group of rows.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Final

from benchmarks.studies.static_reconstruction.arguments import Campaign
from benchmarks.studies.static_reconstruction.declaration import Declaration, load_declaration
from benchmarks.studies.static_reconstruction.groups import Group, Name, groups
from benchmarks.studies.static_reconstruction.headlines import (
    budget_table,
    scene_table,
    summary_table,
    tuning_cell_table,
)
from benchmarks.studies.static_reconstruction.records import Records, read_records, read_trials
from benchmarks.studies.static_reconstruction.settings import settings_tables
from benchmarks.studies.static_reconstruction.tables import (
    COMPARED,
    JobResult,
    differences_table,
    mean_tables,
    read_results,
)
from benchmarks.studies.static_reconstruction.truth.tables import TABLES as TRUTH_TABLES
from benchmarks.studies.static_reconstruction.truth.tables import exact_street_table, select_truth
from benchmarks.studies.static_reconstruction.tuning_tables import choices_table, grid_table
from mirror.errors import SchemaError
from mirror.schema.files import write_bytes

_SECTION: Final = re.compile(r"<!-- begin: (?P<command>[^\n]*?) -->\n(?P<body>.*?)<!-- end -->", re.DOTALL)
_MARK: Final = re.compile(r"<!-- (begin: |end -->)")


@dataclass(frozen=True, eq=False)
class Published:
    """Published records, of which the tables are made.

    Attributes:
        file: of the published records.
        declaration: of the study.
    """

    file: Path
    declaration: Declaration

    @cache  # noqa: B019 - two campaigns of one file
    def records(self, campaign: Campaign = "main") -> Records:
        """Return the records of a campaign."""
        return read_records(self.file, campaign)

    def results(self, campaign: Campaign = "main") -> list[JobResult]:
        """Return the figures of a campaign's jobs."""
        return read_results(self.records(campaign).outcomes)

    def trials(self) -> list[JobResult]:
        """Return the figures of the tuning's trials."""
        return read_results(read_trials(self.file).outcomes)

    def group(self, name: Name) -> Group:
        """Return a group of rows."""
        return groups(self.declaration)[name]


def group_tables(results: Sequence[JobResult], group: Group, minutes: float) -> Iterator[str]:
    """Yield the tables of a group's means with one budget, then of the differences to the group's reference rows."""
    own = [one for one in results if group.has(one.job) and one.job.core_minutes == minutes]
    yield from mean_tables(own, group.shown)
    for row in group.against:
        if text := differences_table(own, row, group.shown, COMPARED):
            yield text


def _results(published: Published, name: Name, campaign: Campaign = "main") -> str:
    group, parts = published.group(name), []
    for minutes in group.minutes:
        if len(group.minutes) > 1:
            parts.append(f"{minutes:g} core-minutes a block, {group.width_px} px")
        parts += group_tables(published.results(campaign), group, minutes)
    return "\n\n".join(parts)


def _scenes(published: Published) -> str:
    return scene_table(published.results(), published.records().exact_street, published.group("comparison"))


def _truth(part: str, published: Published, name: Name, *entries: str) -> str:
    found = select_truth(published.records().truth, published.group(name))
    return TRUTH_TABLES[part](found if not entries else [one for one in found if one["job"]["entry"] in entries])


TABLES: Final[Mapping[str, Callable[..., str]]] = {
    "summary": lambda published: summary_table(published.results(), published.declaration),
    "settings": lambda published, name: "\n\n".join(settings_tables(published.group(name).shown)),
    "results": _results,
    "scenes": _scenes,
    "budgets": lambda published: budget_table(published.results(), published.group("budgets")),
    "tuning-cells": lambda published: tuning_cell_table(published.results(), published.declaration),
    "tuning-grid": lambda published: grid_table(published.trials(), published.declaration.tuning),
    "tuning-choices": lambda published: choices_table(published.trials()),
    "exact-street": lambda published, name: exact_street_table(published.records().exact_street, published.group(name)),
    **{part: partial(_truth, part) for part in TRUTH_TABLES},
}  # fmt: skip
"""The maker of each table, by the first word of its command."""


def render_report(text: str, file: Path, records: Path) -> str:
    """Return a report's text with its tables made from published records.

    Args:
        text: of the report.
        file: named by errors.
        records: file of the published records.

    Raises:
        SchemaError: a marker without its partner, a command that is unknown, or one that makes no table.
    """
    published = Published(records, load_declaration())

    def section(found: re.Match[str]) -> str:
        name, *words = found["command"].split()
        place = f"line {text.count(chr(10), 0, found.start()) + 1}"
        if name not in TABLES:
            raise SchemaError(f"no table {name!r}", file=file, place=place, expected=" or ".join(TABLES))
        table = TABLES[name](published, *words)
        if not table:
            raise SchemaError("no records of this table", file=file, place=place, remedy="run and publish its jobs")
        return f"<!-- begin: {found['command']} -->\n\n{table}\n\n<!-- end -->"

    outside = _MARK.search(_SECTION.sub("", text))
    if outside or any(_MARK.search(found["body"]) for found in _SECTION.finditer(text)):
        raise SchemaError("a marker without its partner", file=file, expected="<!-- begin: ... --> and <!-- end -->")
    return _SECTION.sub(section, text)


def write_report(file: Path, records: Path) -> None:
    """Bring the tables of a report up to date with published records."""
    write_bytes(file, render_report(file.read_text(), file, records).encode())
