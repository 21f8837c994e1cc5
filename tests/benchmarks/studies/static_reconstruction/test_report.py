"""The report's tables equal those of the published records."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from benchmarks.__main__ import main
from benchmarks.studies.static_reconstruction.arguments import Arguments
from benchmarks.studies.static_reconstruction.declaration import load_declaration
from benchmarks.studies.static_reconstruction.groups import Name, groups
from benchmarks.studies.static_reconstruction.jobs import Job
from benchmarks.studies.static_reconstruction.records import read_records
from benchmarks.studies.static_reconstruction.report import render_report
from benchmarks.studies.static_reconstruction.verbs import VERBS
from mirror.errors import DatasetError, SchemaError

STUDY = Arguments(published=True)
REPORT = STUDY.out / "report.md"


PUBLISHED = {Job(**outcome["job"]) for outcome in read_records(STUDY.outcomes).outcomes}


def has_run(group: Name) -> bool:
    """Return whether an outcome of this group, and not of `comparison`, is published."""
    known = groups(load_declaration())
    shared = set(known["comparison"].jobs) if group != "comparison" else set()
    return bool(PUBLISHED & (set(known[group].jobs) - shared))


GROUPS = [name for name in groups(load_declaration()) if name != "tuning" and has_run(name)]


def test_the_report_is_up_to_date_with_the_records() -> None:
    text = REPORT.read_text()
    assert render_report(text, REPORT, STUDY.outcomes) == text


def test_the_report_has_the_tables_of_all_groups() -> None:
    commands = set(re.findall(r"<!-- begin: (.*?) -->", REPORT.read_text()))
    assert {f"results {name}" for name in GROUPS} <= commands
    assert {"settings comparison", "settings released", "exact-street comparison", "tuning-grid"} <= commands


@pytest.mark.parametrize("verb", ["show", "truth"])
@pytest.mark.parametrize("group", GROUPS)
def test_rows_that_verbs_print_are_in_the_report(verb: str, group: Name, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["static_reconstruction", verb, "--published", "--group", group]
    if verb == "truth" and group == "long":
        # No model of this group was measured.
        assert main(command) == 2 and "no measured model" in capsys.readouterr().err
        return
    assert main(command) == 0
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    assert rows and set(rows) <= set(REPORT.read_text().splitlines())


def test_the_repeated_campaign_is_shown_apart(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = Arguments("show", published=True, campaign="repeated", group="bytes")
    VERBS["show"](arguments, load_declaration())
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith("| ")]
    assert set(rows) <= set(REPORT.read_text().splitlines())
    with pytest.raises(DatasetError, match="no outcome of group long"):
        VERBS["show"](Arguments("show", published=True, campaign="repeated", group="long"), load_declaration())


def test_the_verb_updates_a_stale_report(tmp_path: Path) -> None:
    arguments = Arguments("report", out=tmp_path)
    shutil.copy(STUDY.outcomes, arguments.outcomes)
    report, text = tmp_path / "report.md", REPORT.read_text()
    report.write_text(text.replace("31.40", "99.99"))
    assert report.read_text() != text
    assert VERBS["report"](arguments, load_declaration()) == 0
    assert report.read_text() == text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<!-- begin: nothing -->\n<!-- end -->", "line 1: no table 'nothing'"),
        ("a\n<!-- begin: seams released -->\n<!-- end -->", "line 2: no records of this table"),
        ("<!-- begin: tuning-grid -->\n", "a marker without its partner"),
        ("<!-- end -->", "a marker without its partner"),
        ("<!-- begin: budgets -->\n<!-- begin: budgets -->\n<!-- end -->", "a marker without its partner"),
    ],
)
def test_wrong_markers_are_refused(text: str, message: str) -> None:
    with pytest.raises(SchemaError, match=re.escape(message)):
        render_report(text, REPORT, STUDY.outcomes)


def test_the_report_names_the_declaration() -> None:
    assert load_declaration().hash[:16] in REPORT.read_text()
