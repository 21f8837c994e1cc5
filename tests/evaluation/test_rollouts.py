"""Rollouts scored by the protocol safety: figures, hashes, the board, and what is refused."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from mirror.cli.main import main
from mirror.errors import DatasetError, SchemaError, UsageError
from mirror.evaluation.rollouts import evaluate_rollouts, find_rollouts
from mirror.evaluation.run import read_result
from mirror.metrics.safety import score_rollout, write_state_log
from mirror.protocols.document import load_protocol
from mirror.schema.files import write_json
from mirror.schema.road_map import write_road_map
from mirror.schema.rollout import Rollout, list_files
from mirror.schema.scenario import Scenario, write_scenario
from tests.metrics.safety.logs import constant, state_log
from tests.metrics.safety.streets import two_way_street, with_signal

TIMES = 0.1 * np.arange(51)
ROUTE = tuple((float(x), 0.0) for x in range(-40, 121, 4))
PROTOCOL = load_protocol("safety")


def drive(folder: Path, scenario: str, seed: int = 0, *, gap_m: float = 300.0, **more: object) -> Path:
    """Write a rollout behind a standing car."""
    run = folder / f"{scenario}-{seed}"
    log = state_log(TIMES, constant(0.0, 0.1 * seed, 0.0, 10.0, TIMES), constant(gap_m, 0.0, 0.0, 0.0, TIMES))
    write_state_log(run / "states.parquet", with_signal(log, [0] * len(TIMES)))
    write_scenario(run / "scenario.toml", Scenario(name=scenario, duration_s=5.0, ego={"speed_mps": 10.0}))
    write_road_map(run / "map.parquet", two_way_street())
    document = {
        "scene_id": "street", "scenario": scenario, "scenario_version": 1, "policy": "cautious", "world": "boxes",
        "seed": seed, "rate_hz": 10.0, "steps": 50, "ending": "duration", "route_m": ROUTE, "versions": {"mirror": "1"},
        "files": list_files(run), **more,
    }  # fmt: skip
    write_json(run / "run.json", Rollout.model_validate(document))
    return run


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Six scenarios with two seeds; in one of them, the ego collides."""
    for number in range(6):
        for seed in range(2):
            drive(tmp_path / "runs", f"scenario{number}", seed, gap_m=40.0 if number == 0 else 300.0)
    return tmp_path / "runs"


def test_figures_are_means_over_scenarios(runs: Path, tmp_path: Path) -> None:
    evaluation = evaluate_rollouts(runs, PROTOCOL, tmp_path / "out")
    result = read_result(tmp_path / "out")
    assert result == evaluation.result
    assert result.protocol_hash == PROTOCOL.hash
    group = {figure.metric: figure for figure in result.figures if figure.level == "group"}
    assert list(group) == list(PROTOCOL.metric_names)
    assert group["at_fault_collisions"].value == pytest.approx(1 / 6)
    assert group["epdms"].value == pytest.approx(5 / 6)
    assert group["least_ttc"].value == pytest.approx(5 / 6 * 3.0)
    assert group["impact_speed"].value == pytest.approx(10.0 / 6)
    assert all(figure.n == 12 for figure in group.values())
    # Intervals resample scenarios, so that they contain means without and with several collisions.
    assert group["epdms"].low < 5 / 6 < group["epdms"].high <= 1.0
    scenarios = {
        figure.key: figure.value for figure in result.figures if (figure.level, figure.metric) == ("traversal", "epdms")
    }
    assert scenarios == {"scenario0": 0.0, **{f"scenario{number}": 1.0 for number in range(1, 6)}}
    table = pq.read_table(tmp_path / "out" / "images.parquet").to_pylist()
    assert len(table) == 12
    hit = [row for row in table if row["collisions"]]
    assert {row["collisions_cause"] for row in hit} == {"agent1"}
    assert {row["traversal_id"] for row in hit} == {"scenario0"}


def test_values_are_those_of_the_metrics(runs: Path, tmp_path: Path) -> None:
    scored = evaluate_rollouts(runs, PROTOCOL, tmp_path / "out").scored[0]
    log = with_signal(
        state_log(TIMES, constant(0, 0, 0, 10.0, TIMES), constant(40.0, 0, 0, 0.0, TIMES)), [0] * len(TIMES)
    )
    figures = score_rollout(log, two_way_street(), ROUTE, reference_m=50.0).figures
    for name, value in scored.values.items():
        assert value == pytest.approx(figures[name].value), name


def test_hashes_identify_policy_scenarios_and_logs(runs: Path, tmp_path: Path) -> None:
    one = evaluate_rollouts(runs, PROTOCOL, tmp_path / "one").result
    again = evaluate_rollouts(runs, PROTOCOL, tmp_path / "again").result
    assert (one.hash, one.submission_hash, one.dataset) == (again.hash, again.submission_hash, again.dataset)
    other = drive(tmp_path / "other", "scenario0", gap_m=41.0)
    moved = evaluate_rollouts(other, PROTOCOL, tmp_path / "moved").result
    assert moved.dataset.dataset_hash == one.dataset.dataset_hash
    assert moved.submission_hash != one.submission_hash
    assert moved.dataset.plan_hash != one.dataset.plan_hash
    only = evaluate_rollouts(runs / "scenario0-0", PROTOCOL, tmp_path / "only").result
    assert only.dataset.plan_hash == moved.dataset.plan_hash
    assert {figure.interval_reason for figure in only.figures} == {"fewer than 5 scenarios"}


def test_a_row_stands_on_the_board(runs: Path, tmp_path: Path) -> None:
    from mirror_leaderboard.add import add_result
    from mirror_leaderboard.boards import make_boards
    from mirror_leaderboard.entry import Measured, load_entries
    from mirror_leaderboard.rescore import Sources

    evaluate_rollouts(runs, PROTOCOL, tmp_path / "out")
    add_result(tmp_path / "out" / "result.json", tmp_path / "board", "Synthetic street", sources=Sources(str(runs)))
    (entry,) = load_entries(tmp_path / "board" / "entries")
    # Nobody has driven the controls again (tests/leaderboard/test_rollout_attacks.py).
    assert isinstance(entry, Measured) and not entry.verified
    (board,) = make_boards([entry])
    assert dict(board.options)["unverified:"] == "the controls were not driven again"
    assert (board.protocol, board.ranked_by) == ("safety", ("rollouts", "epdms"))
    assert board.entries[0].method == "cautious"
    assert {metric for _, metric in board.columns} == set(PROTOCOL.metric_names)


def test_the_board_takes_the_figures_of_the_state_logs_and_no_others(runs: Path, tmp_path: Path) -> None:
    from mirror_leaderboard.add import add_result
    from mirror_leaderboard.refused import RefusedError
    from mirror_leaderboard.rescore import Sources

    result = evaluate_rollouts(runs, PROTOCOL, tmp_path / "out").result
    path, board, sources = tmp_path / "out" / "result.json", tmp_path / "board", Sources(str(runs))
    with pytest.raises(RefusedError, match="taken from their state logs"):
        add_result(path, board, "Synthetic street")
    better = [
        figure.model_copy(update={"value": 1.0, "low": 1.0, "high": 1.0}) if figure.metric == "epdms" else figure
        for figure in result.figures
    ]
    write_json(path, result.model_copy(update={"figures": tuple(better)}))
    with pytest.raises(RefusedError, match="epdms"):
        add_result(path, board, "Synthetic street", sources=sources)
    write_json(path, result)
    other = drive(tmp_path / "other", "scenario0", gap_m=41.0)
    with pytest.raises(RefusedError, match="submission_hash"):
        add_result(path, board, "Synthetic street", sources=Sources(str(other)))
    assert not board.exists()


def test_the_verb(runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["evaluate", str(runs), "--protocol", "safety", "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "epdms" in said
    assert "every rollout" in said
    assert main(["evaluate", str(runs / "scenario1-0"), "--json", "--out", str(tmp_path / "one")]) == 0
    assert json.loads(capsys.readouterr().out)["result"]["submission"]["method"]["name"] == "cautious"
    assert main(["evaluate", str(runs), "--split", "test"]) == 2
    assert "--split" in capsys.readouterr().err
    assert main(["evaluate", str(runs), "--protocol", "runtime"]) == 2
    assert "scores renders" in capsys.readouterr().err
    assert main(["evaluate", str(runs / "scenario1-0"), "--out", str(runs / "scenario1-0" / "results")]) == 2
    assert "a rollout" in capsys.readouterr().err


def test_the_report_leads_with_the_best_median_and_worst_rollouts(runs: Path, tmp_path: Path) -> None:
    assert main(["evaluate", str(runs), "--report", "--out", str(tmp_path / "out")]) == 0
    page = (tmp_path / "out" / "report.html").read_text()
    titles = re.findall(r"<figcaption>(\w+): [^<]*EPDMS ([\d.]+)</figcaption>", page)
    assert [name for name, _ in titles] == ["best", "best", "median", "median", "worst", "worst"]
    scores = [float(score) for _, score in titles]
    assert scores == sorted(scores, reverse=True) and scores[0] > scores[-1]
    # The two worst ones have three series each below the view from above.
    assert page.count("<svg") == 6 + 2 * 3 and page.count("<circle") == 2
    assert page.count("<animate ") >= 2 and "Time to collision: " in page and "<script" not in page
    assert page.rindex("<svg") < page.index("<h2>Figures</h2>") < page.index("<h2>Rollouts</h2>")
    assert "12</b><span>rollouts of 6 scenarios" in page and "2</b><span>with a collision" in page
    assert "By scenario" in page and "http" not in page.replace("http-equiv", "")
    assert page.count("<tr>") >= 12 + 6
    assert "Paired with" not in page
    words = ["evaluate", str(runs), "--report", "--baseline", str(tmp_path / "out"), "--out", str(tmp_path / "again")]
    assert main(words) == 0
    again = (tmp_path / "again" / "report.html").read_text()
    assert "<h2>Paired with cautious</h2>" in again and "+0.000" in again
    assert main([word for word in words if word != "--report"]) == 2


def test_failed_policies_are_scored_with_a_warning_and_interrupted_rollouts_are_refused(tmp_path: Path) -> None:
    drive(tmp_path / "runs", "scenario0", ending="policy", reason="no answer within 1 s")
    result = evaluate_rollouts(tmp_path / "runs", PROTOCOL, tmp_path / "out").result
    assert "no answer within 1 s" in result.warnings[0]
    drive(tmp_path / "runs", "scenario1", ending="interrupted")
    with pytest.raises(UsageError, match="was interrupted"):
        evaluate_rollouts(tmp_path / "runs", PROTOCOL, tmp_path / "out")


@pytest.mark.parametrize("difference", [{"policy": "other"}, {"world": "exact"}, {"model_hash": "0" * 64}])
def test_rollouts_of_several_policies_or_worlds_are_refused(difference: dict[str, str], tmp_path: Path) -> None:
    drive(tmp_path, "scenario0")
    drive(tmp_path, "scenario1", **difference)
    with pytest.raises(UsageError, match=next(iter(difference))):
        evaluate_rollouts(tmp_path, PROTOCOL, tmp_path / "out")


def test_incomplete_and_changed_rollouts_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no such folder"):
        find_rollouts(tmp_path / "missing")
    run = drive(tmp_path / "runs", "scenario0")
    assert find_rollouts(tmp_path / "runs") == find_rollouts(run) == [run]
    document = (run / "run.json").read_text()
    (run / "run.json").unlink()
    for name, kind, problem in (
        ("dataset.json", "mirror", "a dataset, and no submission given"),
        ("manifest.json", "mirror-submission", r"a submission \(of renders\)"),
    ):
        write_json(tmp_path / kind / name, {"format": kind})
        with pytest.raises(UsageError, match=problem):
            find_rollouts(tmp_path / kind)
    with pytest.raises(UsageError, match="no complete rollout"):
        find_rollouts(tmp_path / "runs")
    (run / "run.json").write_text(document.replace('"steps": 50', '"steps": -1'))
    with pytest.raises(SchemaError, match="greater than or equal to 0"):
        evaluate_rollouts(run, PROTOCOL, tmp_path / "out")
    (run / "run.json").write_text(document)
    log = state_log(TIMES, constant(0, 0, 0, 10.0, TIMES))
    write_state_log(run / "states.parquet", with_signal(log, [0] * len(TIMES)))
    with pytest.raises(DatasetError, match="not the file"):
        evaluate_rollouts(run, PROTOCOL, tmp_path / "out")
    assert not (tmp_path / "out" / "result.json").exists()
    twice = drive(tmp_path / "twice" / "a", "scenario0"), drive(tmp_path / "twice" / "b", "scenario0")
    assert len(twice) == 2
    with pytest.raises(UsageError, match="driven twice"):
        evaluate_rollouts(tmp_path / "twice", PROTOCOL, tmp_path / "out")


def test_missing_values_have_reasons(tmp_path: Path) -> None:
    run = drive(tmp_path, "scenario0")
    log = state_log(TIMES, constant(0, 0, 0, 10.0, TIMES))
    write_state_log(run / "states.parquet", replace(log, signals=()))
    document = json.loads((run / "run.json").read_text())
    (run / "run.json").unlink()
    document["files"] = {name: entry.model_dump() for name, entry in list_files(run).items()}
    write_json(run / "run.json", Rollout.model_validate(document))
    result = evaluate_rollouts(run, PROTOCOL, tmp_path / "out").result
    figure = next(one for one in result.figures if (one.metric, one.level) == ("epdms", "group"))
    assert (figure.value, figure.n_missing) == (None, 1)
    assert "signal 's'" in figure.reason
