"""Ranks of boards: from the values of clusters that entries keep, on the page, in CSV and in JSON."""

from __future__ import annotations

import csv
import json
import re
from pathlib import Path

import numpy as np
import pytest

from mirror.protocols.document import load_protocol
from mirror_leaderboard.boards import Board, make_boards
from mirror_leaderboard.entry import Cluster, Figure, Measured, load_entries
from mirror_leaderboard.ranks import Rank
from mirror_leaderboard.site.page import build_site
from tests.leaderboard.browser import Browser
from tests.leaderboard.conftest import MEASURED, measured

SCENES = 12


def entry(method: str, mean: float, *, scenes: int = SCENES, spread: float = 0.01, **changes: object) -> Measured:
    """An entry with a value of each scene; the deviations of methods differ."""
    noise = np.random.default_rng(sum(map(ord, method))).standard_normal(scenes)
    # What is hard for all of them differs by more than the methods do.
    hard = 0.1 * np.random.default_rng(0).standard_normal(scenes)
    values = mean + spread * (noise - noise.mean()) + hard - hard.mean() if scenes else np.zeros(0)
    clusters = tuple(
        Cluster(key=f"scene-{place:02}", value=float(value), weight=1 / scenes, n=4)
        for place, value in enumerate(values)
    )
    figure = Figure(group="novel", metric="matched_structure", value=mean, n=4 * max(scenes, 1))
    hashes = {"result_hash": f"{sum(map(ord, method)):064x}"}
    return measured(method, 20.0, figures=(figure,), clusters=clusters, pairs=(), **hashes, **changes)


def board_of(*entries: Measured) -> Board:
    (board,) = make_boards(entries)
    return board


def shown(board: Board) -> dict[str, str]:
    assert board.ranks is not None
    return {row.method: f"{rank.rank} ({rank.low}-{rank.high})" for row, rank in zip(board.entries, board.ranks.rows)}


FIVE = (entry("best", 0.8), entry("near", 0.801), entry("middle", 0.5), entry("low", 0.3), entry("close", 0.302))


def test_rows_that_are_not_separated_share_a_rank() -> None:
    board = board_of(*FIVE)
    assert shown(board) == {
        "near": "1 (1-2)", "best": "1 (1-2)", "middle": "3 (3-3)", "close": "4 (4-5)", "low": "4 (4-5)",
    }  # fmt: skip
    assert board.ranks is not None
    assert (board.ranks.cluster, board.ranks.n_clusters, board.ranks.reason) == ("scene", SCENES, None)


def test_the_weights_of_clusters_count() -> None:
    """In most scenes the second is better, but the scene in which it is far worse has half of the weight."""
    weights = [0.5, *[0.5 / 11] * 11]

    def row(method: str, values: list[float]) -> Measured:
        clusters = [
            Cluster(key=f"{place:02}", value=value, weight=weight, n=1)
            for place, (value, weight) in enumerate(zip(values, weights))
        ]
        value = sum(one * weight for one, weight in zip(values, weights))
        return entry(method, value).model_copy(update={"clusters": tuple(clusters)})

    board = board_of(row("first", [0.9, *[0.5] * 11]), row("second", [0.1, *[0.52] * 11]))
    assert [one.method for one in board.entries] == ["first", "second"]
    # One scene decides, which a resampling may lack.
    assert shown(board) == {"first": "1 (1-2)", "second": "1 (1-2)"}


def test_rows_without_values_of_scenes_are_not_ranked_beside_the_others() -> None:
    board = board_of(*FIVE, entry("former", 0.6, scenes=0), entry("partial", 0.7, scenes=SCENES - 1))
    assert board.ranks is not None
    rows = dict(zip([row.method for row in board.entries], board.ranks.rows))
    assert rows["middle"] == Rank(3, 3, 3)
    assert rows["former"] == Rank(reason="not ranked beside the others: the entry keeps no values of single scenes")
    assert rows["partial"] == Rank(reason="not ranked beside the others: the entry keeps values of other scenes")


@pytest.mark.parametrize(
    ("scenes", "reason"),
    [
        (0, "the entries keep no values of single scenes"),
        (3, "3 scenes, of which they need 5"),
    ],
)
def test_without_enough_scenes_ranks_are_places(scenes: int, reason: str) -> None:
    board = board_of(*(entry(name, mean, scenes=scenes) for name, mean in (("a", 0.5), ("b", 0.7), ("c", 0.5))))
    assert board.ranks is not None
    assert board.ranks.reason == reason
    assert shown(board) == {"b": "1 (None-None)", "a": "2 (None-None)", "c": "2 (None-None)"}


def test_drives_are_resampled_by_scenario_and_ranked_by_their_score() -> None:
    protocol = load_protocol("safety")
    rows = []
    for row in FIVE:
        figure = row.figures[0].model_copy(update={"group": "rollouts", "metric": "epdms"})
        update = {"protocol": "safety", "protocol_hash": protocol.hash, "figures": (figure,), "verified": True}
        rows.append(row.model_copy(update=update))
    board = board_of(*rows)
    assert board.ranks is not None
    assert (board.ranks.cluster, board.ranks.n_clusters) == ("scenario", SCENES)
    assert shown(board)["middle"] == "3 (3-3)"


def test_reported_rows_and_older_entries_have_no_intervals() -> None:
    for board in make_boards(load_entries(MEASURED)):
        assert board.ranks is None or board.ranks.reason is not None


def test_ranks_are_on_the_page_in_csv_and_in_json(tmp_path: Path) -> None:
    entries = [*FIVE, entry("former", 0.6, scenes=0)]
    text = build_site(entries, [], tmp_path).read_text()
    cells = [re.sub("<[^>]*>", "", cell) for cell in re.findall(r'<td class="n rank"[^>]*>(.*?)</td>', text)]
    assert cells == ["1 (1\u20132)", "1 (1\u20132)", "\u20131", "3 (3\u20133)", "4 (4\u20135)", "4 (4\u20135)"]
    assert "ranks with 95 % intervals over 12 scenes" in text
    assert "not ranked beside the others: the entry keeps no values of single scenes" in text
    (file,) = (tmp_path / "csv").iterdir()
    rows = list(csv.DictReader(file.read_text().splitlines()))
    assert [rows[3][name] for name in ("method", "rank", "rank low", "rank high")] == ["middle", "3", "3", "3"]
    (file,) = (tmp_path / "ranks").iterdir()
    plain = json.loads(file.read_text())
    assert plain["intervals"] == {"confidence": 0.95, "cluster": "scene", "n_clusters": 12, "reason": None}
    assert [(row["method"], row["rank"], row["low"], row["high"]) for row in plain["rows"][:3]] == [
        ("near", 1, 1, 2), ("best", 1, 1, 2), ("former", None, None, None),
    ]  # fmt: skip


def test_a_browser_sorts_by_rank(tmp_path: Path, browser: Browser) -> None:
    browser.open(build_site([*FIVE, entry("former", 0.6, scenes=0)], [], tmp_path))
    methods = "[...document.querySelector('table.board').tBodies[0].rows].map(row => row.cells[1].dataset.value)"
    browser.script("document.querySelectorAll('table.board thead button')[0].click()")
    assert browser.script(methods) == ["near", "best", "middle", "close", "low", "former"]
    browser.script("document.querySelectorAll('table.board thead button')[0].click()")
    assert browser.script(methods)[0] in ("close", "low")
    assert browser.script(methods)[-1] == "former"
