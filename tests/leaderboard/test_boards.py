"""Boards: which entries they hold, their order, and their best values; the checks of entries."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mirror.errors import DatasetError, MirrorError, SchemaError
from mirror.metrics.catalogue import MEASURES
from mirror.protocols.document import load_protocol, protocol_names
from mirror.schema.files import write_json
from mirror_leaderboard.boards import FLOOR, FLOOR_OF_EDITS, find_value, make_boards, seconds_per_image
from mirror_leaderboard.entry import Figure, Measured, Reported, load_entries
from mirror_leaderboard.site.page import build_site
from tests.leaderboard.conftest import MEASURED, REPORTED, measured


def test_measured_and_reported_never_share_a_table(board: Path) -> None:
    for table in make_boards(load_entries(board / "entries")):
        assert len({entry.kind for entry in table.entries}) == 1


def test_other_hashes_make_another_table() -> None:
    entries = [
        measured("a", 20.0),
        measured("b", 21.0),
        measured("c", 22.0, dataset_hash="ef" * 32),
        measured("d", 23.0, split="other"),
        measured("e", 24.0, protocol_hash="01" * 32),
        measured("f", 25.0, options={"extractor": "file"}),
    ]
    boards = make_boards(entries)
    assert [len(board.entries) for board in boards].count(2) == 1
    assert len(boards) == 5
    assert len({board.id for board in boards}) == 5


def test_rows_are_sorted_by_the_protocols_column() -> None:
    (board,) = make_boards([measured("low", 10.0), measured("high", 30.0), measured("middle", 20.0)])
    assert board.ranked_by == ("novel", "matched_structure")
    assert [entry.method for entry in board.entries] == ["high", "middle", "low"]
    assert board.best(("novel", "psnr")) == 30.0
    assert board.best(("novel", "lpips_alex")) is None


def test_older_tables_keep_their_version_and_its_key() -> None:
    entries = [entry for entry in load_entries(MEASURED) if isinstance(entry, Measured)]
    found = {(board.protocol, board.entries[0].protocol_version): board.ranked_by for board in make_boards(entries)}
    former = {
        ("static-reconstruction", 1): ("training", "psnr"),
        ("static-reconstruction", 2): ("novel", "psnr_invariant"),
        ("lane-shift", 1): ("right-3m", "psnr"),
        ("lane-shift", 2): ("right-3m", "psnr"),
    }
    assert former.items() <= found.items()


def test_the_mean_over_groups_ranks_moved_cameras() -> None:
    protocol = load_protocol("lane-shift")
    assert protocol.ranking is not None
    group, metric = protocol.ranking.column

    def row(method: str, ranks: float, right: float) -> Measured:
        figures = tuple(
            Figure(group=name, metric=metric, value=value, n=6) for name, value in ((group, ranks), ("right-3m", right))
        )
        return measured(
            method, 20.0, protocol="lane-shift", protocol_hash=protocol.hash, figures=figures, result_hash=method * 64
        )

    (board,) = make_boards([row("a", 0.2, 0.9), row("b", 0.5, 0.1)])
    assert (board.ranked_by, [entry.method for entry in board.entries]) == (("all", metric), ["b", "a"])


def test_lower_distances_are_better() -> None:
    boards = [board for board in make_boards(load_entries(REPORTED)) if board.protocol == "vehicle-translation"]
    for board in boards:
        assert [entry.method for entry in board.entries] == ["HybridWorldSim", "DriveEditor"]
        for column in board.columns:
            assert board.best(column) == min(find_value(entry, column) for entry in board.entries)


def test_columns_are_in_the_protocols_order() -> None:
    (board,) = make_boards([measured("a", 10.0)])
    # The group and the metric that rank come first; LPIPS has no value.
    assert board.columns == (
        ("novel", "matched_structure"),
        ("novel", "psnr"),
        ("novel", "psnr_invariant"),
        ("novel", "psnr_cc"),
        ("novel", "ssim"),
        ("training", "psnr"),
    )
    offsets = [board for board in make_boards(load_entries(REPORTED)) if board.title == "MIRROR"][1]
    assert [group for group, _ in offsets.columns] == ["right-3m", "right-1.5m", "0m", "left-1.5m", "left-3m"]


def test_the_speed_of_the_static_scene_is_not_that_of_generation() -> None:
    entries = [entry for entry in load_entries(REPORTED) if isinstance(entry, Reported)]
    known = {(entry.method, entry.protocol) for entry in entries if seconds_per_image(entry, entries) is not None}
    assert known == {("HybridWorldSim", "static-reconstruction")}
    assert seconds_per_image(measured("a", 20.0), []) == pytest.approx(1 / 20.0)


def test_every_metric_of_every_protocol_is_known() -> None:
    composite = {"nuscenes_detection"}
    for name in protocol_names():
        assert set(load_protocol(name).metric_names) - composite <= set(MEASURES), name


def test_all_floors_are_on_the_board() -> None:
    measured = [entry for entry in load_entries(MEASURED) if isinstance(entry, Measured)]
    by_protocol = {
        protocol: {entry.method for entry in measured if entry.protocol_hash == load_protocol(protocol).hash}
        for protocol in ("static-reconstruction", "editing-accuracy")
    }
    assert set(FLOOR) <= by_protocol["static-reconstruction"]
    assert set(FLOOR_OF_EDITS) <= by_protocol["editing-accuracy"]


def test_changed_entry_is_refused_by_name(board: Path) -> None:
    path = board / "entries" / "measured-mean_color.json"
    plain = json.loads(path.read_text())
    plain["figures"][1]["value"] = 40.0
    path.write_text(json.dumps(plain))
    with pytest.raises(SchemaError, match=r"measured-mean_color\.json: seal"):
        load_entries(board / "entries")


def test_repeated_entry_is_refused_by_name(board: Path) -> None:
    write_json(board / "entries" / "measured-again.json", measured("mean_color", 35.0, result_hash="99" * 32))
    with pytest.raises(SchemaError, match=r"measured-again\.json"):
        load_entries(board / "entries")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"metric": "beauty"}, "is unknown"),
        ({"metric": "ssim", "value": 1.5}, "outside -1 to 1"),
        ({"value": float("nan")}, "finite"),
        ({"value": float("inf")}, "finite"),
        ({"value": None}, "no note"),
        ({"value": -3.0}, "outside 0 to inf"),
        ({"low": 1.0}, "only one end of a confidence interval"),
        ({"low": 3.0, "high": 1.0}, "ends before"),
    ],
)
def test_impossible_figure_is_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Figure.model_validate({"group": "novel", "metric": "psnr", "value": 20.0, **changes})


@pytest.mark.parametrize("link", ["javascript:alert(1)", "http://a.b", "https://a.b/\"onclick='x'", "https://a.b/\n"])
def test_unsafe_link_is_refused(link: str) -> None:
    with pytest.raises(ValueError):
        measured("a", 20.0, link=link)


@pytest.mark.parametrize("name", ["../x.jpg", "/x.jpg", "a/b/c.jpg", "x.svg", "a/../b.jpg", "x.jpg\n"])
def test_path_of_an_image_outside_its_folder_is_refused(name: str) -> None:
    with pytest.raises(ValueError):
        measured("a", 20.0, pairs=({"view": "v", "render": name, "truth": "t.jpg"},))


def test_unknown_protocol_and_missing_folder_are_refused(board: Path) -> None:
    write_json(board / "entries" / "measured-x.json", measured("x", 20.0, protocol="beauty"))
    with pytest.raises(SchemaError, match="unknown protocol 'beauty'"):
        load_entries(board / "entries")
    with pytest.raises(DatasetError, match="no such folder"):
        load_entries(board / "nothing")


def test_broken_json_is_refused_by_name(board: Path) -> None:
    (board / "entries" / "broken.json").write_text("{")
    with pytest.raises(MirrorError, match=r"broken\.json"):
        load_entries(board / "entries")


@pytest.mark.filterwarnings("ignore:Pydantic serializer warnings")
def test_seal_covers_all_other_fields() -> None:
    entry = measured("a", 20.0)
    assert entry.seal == entry.content_hash
    for name in Measured.model_fields:
        if name not in ("seal", "kind", "key", "signed_on", "signature"):
            changed = entry.model_copy(update={name: "other"})
            assert changed.content_hash != entry.content_hash, name


def test_entries_of_different_plans_stand_in_different_tables() -> None:
    """Before: rollouts of ten easy scenarios stood beside rollouts of other ones."""
    rows = [measured("one", 20.0, plan_hash="1" * 64), measured("two", 21.0, plan_hash="2" * 64), measured("old", 19.0)]
    assert [[entry.method for entry in board.entries] for board in make_boards(rows)].count(["one"]) == 1
    assert len({board.id for board in make_boards(rows)}) == 3


def test_figures_that_can_be_forged_rank_nothing_beside_exact_ones(tmp_path: Path) -> None:
    """A flat patch has the best overlap; the exact edit ranks, and overlaps are marked and have no best value."""

    def row(method: str, exact: float | None, overlap: float) -> Measured:
        known = load_protocol("editing-accuracy")
        figures = [Figure(group="all", metric="edit_iou_hull", value=overlap)]
        if exact is not None:
            figures.append(Figure(group="all", metric="ms_structure_least", value=exact))
        changes = {"protocol": known.name, "protocol_version": known.version, "protocol_hash": known.hash}
        return measured(method, 20.0).model_copy(update={**changes, "figures": tuple(figures), "pairs": ()}).sealed()

    (exact,) = make_boards([row("flat_patch", 0.07, 0.95), row("edit", 0.5, 0.6)])
    assert [entry.method for entry in exact.entries] == ["edit", "flat_patch"]
    assert exact.ranked_by == ("all", "ms_structure_least")
    assert exact.best(("all", "edit_iou_hull")) is None and exact.best(exact.ranked_by) == 0.5
    (recorded,) = make_boards([row("flat_patch", None, 0.95), row("edit", None, 0.6)])
    assert recorded.ranked_by == ("all", "edit_iou_hull") and recorded.best(recorded.ranked_by) == 0.95
    for board in (exact, recorded):
        page = build_site(list(board.entries), [], tmp_path / str(len(board.columns)), draft=True).read_text()
        assert "not proof against forgery" in page
        assert ("ordered by" in page) == (board is recorded)
