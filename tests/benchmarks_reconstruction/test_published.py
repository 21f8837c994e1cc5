"""What docs/results.md says is what its outcomes come to."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks.studies.static_reconstruction.arguments import Arguments, GroupName
from benchmarks.studies.static_reconstruction.declared import declared
from benchmarks.studies.static_reconstruction.groups import Name, groups
from benchmarks.studies.static_reconstruction.job import CEILING, OUTCOMES, TRUTH, Job
from benchmarks.studies.static_reconstruction.verbs import VERBS
from mirror.errors import DatasetError

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "docs" / "results"
ANEW = RESULTS / "anew"
KNOWN = groups(declared())
SHARED = {job.name for job in KNOWN["comparison"].jobs}


def has_run(group: Name) -> bool:
    """Whether something is published that is of this group alone."""
    own = {job.name for job in KNOWN[group].jobs} - (SHARED if group != "comparison" else set())
    return any((RESULTS / OUTCOMES / f"{name}.json").is_file() for name in own)


def is_measured(group: Name) -> bool:
    """Whether models that are shown with a group were held against the truth."""
    there = [path for path in (RESULTS / TRUTH).glob("*.json") if not path.name.startswith(CEILING)]
    return any(KNOWN[group].has(Job(**json.loads(path.read_text())["job"])) for path in there)


GROUPS = [name for name in KNOWN if name != "tuning" and has_run(name)]


@pytest.mark.parametrize("verb", ["show", "truth"])
@pytest.mark.parametrize("group", GROUPS)
def test_tables_of_the_document_are_those_of_the_outcomes(
    verb: str, group: GroupName, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = Arguments(verb, RESULTS, group=group)
    if verb == "truth" and not is_measured(group):
        with pytest.raises(DatasetError, match="no measured model"):
            VERBS[verb](arguments, declared())
        return
    VERBS[verb](arguments, declared())
    assert_written(capsys.readouterr().out)


def test_tables_of_what_was_made_anew_are_those_of_its_outcomes(capsys: pytest.CaptureFixture[str]) -> None:
    VERBS["show"](Arguments("show", ANEW, group="bytes"), declared())
    assert_written(capsys.readouterr().out)


def assert_written(printed: str) -> None:
    """All rows of the tables stand in the document."""
    rows = [line for line in printed.splitlines() if line.startswith("| ")]
    written = set(RESULTS.with_suffix(".md").read_text().splitlines())
    missing = [row for row in rows if row not in written]
    assert rows and not missing, f"docs/results.md lacks what is printed of its outcomes: {missing[:1]}"


@pytest.mark.parametrize("group", [name for name in GROUPS if name in ("comparison", "released")])
def test_settings_in_the_document_are_those_of_the_rows(group: GroupName, capsys: pytest.CaptureFixture[str]) -> None:
    assert VERBS["settings"](Arguments("settings", RESULTS, group=group), declared()) == 0
    tables = capsys.readouterr().out.strip().split("\n\n")
    assert len(tables) == 2 and "| depth_weight | 0.04 | 0.04 |" in tables[0]
    assert all(table in RESULTS.with_suffix(".md").read_text() for table in tables)


def test_the_declaration_that_is_named_is_the_one_that_holds() -> None:
    assert declared().hash[:16] in (ROOT / "docs" / "results.md").read_text()
