"""Reports and the command of the benchmarks, on tiny sizes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import __main__ as command
from benchmarks import report
from benchmarks.report import Peer, Row


@pytest.fixture(autouse=True)
def out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(report, "OUT", tmp_path)
    return tmp_path


def test_rows_are_printed_written_and_plotted(out: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [Row("fast", "1", 1.5, 1e-9, (Peer("slow", 20.0, 1e-3),), "m", 2.0), Row("plain", "1", 3.0)]
    assert report.report("some", {"group": rows}) == 0
    printed = capsys.readouterr().out
    assert "name" in printed.splitlines()[0]
    assert "1e-09 m" in printed
    assert "slow 20 ms, 1e-03" in printed
    assert [row["name"] for row in json.loads((out / "some.json").read_text())] == ["fast", "plain"]
    assert (out / "some.png").stat().st_size > 1000


def test_a_missed_bar_is_a_finding(capsys: pytest.CaptureFixture[str]) -> None:
    assert report.report("some", {"group": [Row("slow", "1", 3.0, bar=2.0)]}) == 1
    assert "MISSED" in capsys.readouterr().out
    assert Row("not measured", "1", float("nan"), bar=2.0).is_missed


def test_the_command_lists_and_refuses(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main([]) == 0
    lines = filter(str.strip, capsys.readouterr().out.splitlines())
    assert {"geometry", "ingest", "query"} <= {line.split()[0] for line in lines}
    assert command.main(["nothing"]) == 2


def test_the_trigger_benchmark_runs(capsys: pytest.CaptureFixture[str]) -> None:
    from benchmarks.ingest.benchmark import trigger_rows

    rows = list(trigger_rows(5_000, 30))
    assert [row.name for row in rows] == [
        "trigger, cleaning included",
        "its times, at 1 m/s and more",
        "its passes",
    ]
    assert all(row.error is not None for row in rows)
    assert (rows[0].error or 0.0) < 1.0
    assert (rows[1].error or 0.0) < 1.0
    assert rows[2].error == 0.0


def test_the_copy_benchmark_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks.ingest import benchmark

    monkeypatch.setattr(benchmark, "PAIRS", 1)
    monkeypatch.setattr(benchmark.os, "sync", lambda: None)
    assert [row.error for row in benchmark.copy_rows(1, tmp_path)] == [0.0, 0.0, 0.0]
