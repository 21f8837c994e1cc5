"""The jobs and rows of each group."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks.__main__ import main
from benchmarks.studies.static_reconstruction.arguments import Arguments
from benchmarks.studies.static_reconstruction.declaration import load_declaration
from benchmarks.studies.static_reconstruction.groups import groups, select_group
from benchmarks.studies.static_reconstruction.jobs import Job
from benchmarks.studies.static_reconstruction.methods import entries
from mirror.errors import ExitCode, UsageError

DECLARED = load_declaration()


def test_groups_cover_all_known_rows() -> None:
    every = {row for group in groups(DECLARED).values() for row in group.shown}
    assert every == set(entries())


def test_groups_run_what_is_declared() -> None:
    known = groups(DECLARED)
    assert len(known["comparison"].jobs) == 7 * len(DECLARED.scenes) * len(DECLARED.seeds)
    assert {job.core_minutes for job in known["budgets"].jobs} == {2.0, 10.0, 30.0}
    assert {(job.core_minutes, job.width_px) for job in known["long"].jobs} == {(30.0, 480)}
    assert known["seam"].has(Job("ours", DECLARED.scenes[0], 0, 10.0, 240))
    assert not known["comparison"].has(Job("ours", DECLARED.scenes[0], 0, 30.0, 240))


def test_differences_compare_shown_rows() -> None:
    for name, group in groups(DECLARED).items():
        assert set(group.against) <= set(group.shown), name


def test_ablations_are_compared_with_the_complete_method() -> None:
    assert entries()["4-traversals"].settings(0) == entries()["ours"].settings(0)


def test_arguments_override_the_group() -> None:
    found = select_group(Arguments(entries=("ours",), scenes=DECLARED.scenes[:1], seeds=(2,), minutes=(1.0,)), DECLARED)
    assert found.jobs == [Job("ours", DECLARED.scenes[0], 2, 1.0, DECLARED.width_px)]


@pytest.mark.parametrize(
    ("arguments", "remedy"),
    [
        (Arguments(entries=("our",)), "no 'our'; expected ours"),
        (Arguments(scenes=("karlsruhe",)), "no 'karlsruhe'; expected karlsruhe-"),
        (Arguments(minutes=(10.0, -1.0)), "--minutes: -1; expected 0.01 or more"),
        (Arguments(width=0), "--width: 0; expected 16 or more"),
        (Arguments(seeds=(-1,)), "--seeds: -1; expected 0 or more"),
    ],
)
def test_unknown_rows_and_scenes_and_small_numbers_are_refused(arguments: Arguments, remedy: str) -> None:
    with pytest.raises(UsageError, match=re.escape(remedy)):
        select_group(arguments, DECLARED)


@pytest.mark.parametrize("verb", ["show", "truth", "figures"])
def test_verbs_without_records_end_with_an_error(verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["reconstruction", verb, "--data", str(tmp_path), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr()
    assert not said.out and "of group comparison" in said.err and "--published" in said.err
    assert not (tmp_path / "out").exists()


def test_jobs_without_scenes_are_refused_before_they_begin(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["static_reconstruction", "run", "--data", str(tmp_path)]) == ExitCode.COULD_NOT_RUN
    assert "static_reconstruction prepare" in capsys.readouterr().err
