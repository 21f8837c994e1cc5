"""Adding results to a board: valid results, and results that are refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mirror.cli.main import main
from mirror.errors import DatasetError, ExitCode, MirrorError
from mirror.protocols.document import load_protocol
from mirror.schema.files import sha256_bytes
from mirror_leaderboard.add import add_result
from mirror_leaderboard.entry import Measured, load_entries
from mirror_leaderboard.refused import RefusedError
from tests.leaderboard.results import HASHES, PROTOCOL, PSNR, SHARED, result


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder of a result, with its table of images."""
    rows = [
        {
            "group": group,
            "scene_id": "s",
            "traversal_id": "two" if group == "training" and place == 2 else "one",
            "psnr": value,
        }
        for group, values in PSNR.items()
        for place, value in enumerate(values)
    ]
    out = tmp_path / "result"
    out.mkdir()
    pq.write_table(pa.Table.from_pylist(rows), out / "images.parquet")
    return out


def write(folder: Path, plain: dict[str, Any]) -> Path:
    path = folder / "result.json"
    path.write_text(json.dumps(plain))
    return path


def test_valid_result_is_added(folder: Path, board: Path) -> None:
    path = add_result(write(folder, result()), board, "a street", setting="slow")
    (entry,) = [entry for entry in load_entries(board / "entries") if entry.method == "a method"]
    assert isinstance(entry, Measured)
    assert path.name.startswith("measured-a-street-a-method-")
    assert (entry.dataset, entry.setting, entry.version, entry.link) == ("a street", "slow", "3", None)
    assert (entry.protocol_hash, entry.dataset_hash) == (PROTOCOL.hash, HASHES["dataset_hash"])
    figures = {(figure.group, figure.metric): figure for figure in entry.figures}
    assert figures["training", "psnr"].value == 22.5
    assert (figures["novel", "psnr"].n_infinite, figures["novel", "psnr"].n_missing) == (1, 1)
    assert figures["novel", "lpips_alex"].value is None
    assert figures["novel", "lpips_alex"].note == "unavailable: alexnet is not there"
    assert figures["novel", "psnr"].note == "no interval: few"
    assert figures["training", "psnr"].note is None
    assert ("novel", "psnr_pooled") not in figures
    assert entry.frames_per_second == 50.0
    assert entry.notes == ("a warning",)


def test_hidden_truth_and_extractors_make_other_tables(folder: Path, board: Path) -> None:
    plain = result()
    plain["dataset"]["hidden_truth"] = "77" * 32
    plain["options"] = {"extractor": "diff-grabcut"}
    add_result(write(folder, plain), board, "a street")
    (entry,) = [entry for entry in load_entries(board / "entries") if entry.method == "a method"]
    assert isinstance(entry, Measured)
    assert entry.options == {"extractor": "diff-grabcut", "hidden truth": "777777777777"}


def test_repeated_result_is_refused(folder: Path, board: Path) -> None:
    path = write(folder, result())
    add_result(path, board, "a street")
    with pytest.raises(RefusedError, match="is on the board already"):
        add_result(path, board, "another name")


def test_the_same_method_twice_needs_another_version_or_setting(folder: Path, board: Path) -> None:
    add_result(write(folder, result()), board, "a street")
    again = {**result(), "warnings": []}
    with pytest.raises(RefusedError, match="a method 3 is on the board already"):
        add_result(write(folder, again), board, "a street")
    add_result(write(folder, again), board, "a street", setting="again")
    again["submission"]["method"]["version"] = "4"
    add_result(write(folder, again), board, "a street")
    assert sum(entry.method == "a method" for entry in load_entries(board / "entries")) == 3


def set_in(*keys: Any) -> Callable[[dict[str, Any]], None]:
    """Return a function that sets the last but one of `keys` to the last one, at the path of the others."""

    def change(plain: dict[str, Any]) -> None:
        *path, last, value = keys
        for key in path:
            plain = plain[key]
        plain[last] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (set_in("figures", 0, "value", 30.0), "psnr of training is 30.0, which is not the mean of its images"),
        (
            set_in("figures", 0, {**SHARED, "group": "training", "value": None, "reason": "so", "n": 3}),
            "psnr of training is None, which is not",
        ),
        (set_in("figures", 0, "n", 300), "states 300 images"),
        (set_in("figures", 2, "n_inf", 0), "states 4 images, 0 of them infinite"),
        (set_in("figures", 0, "group", "hidden"), "no group 'hidden'"),
        (set_in("figures", 0, "metric", "beauty"), "'beauty' is unknown"),
        (set_in("figures", 0, "better", "lower"), "psnr is stated to be better lower"),
        (set_in("figures", 0, "low", 26.0), "ends before it begins"),
        (
            set_in("figures", 3, {"metric": "ssim", "group": "novel", "value": 2.0, "better": "higher", "n": 1}),
            "outside",
        ),
        (set_in("figures", []), "has no figure"),
        (set_in("figures", 2, "level", "scene"), "psnr of novel is missing"),
        (set_in("protocol", "masks", "ego", False), "not the hash of the result's protocol"),
        (set_in("protocol_hash", "00" * 32), "changed by hand"),
        (set_in("submission", "dataset_hash", "00" * 32), "changed by hand"),
        (set_in("submission", "plan_hash", "00" * 32), "changed by hand"),
        (set_in("submission", "split", "easy"), "changed by hand"),
        (set_in("submission", "method", "name", "<b>"), "method: the text has another form"),
        (set_in("format", "other"), "mirror-result"),
        (set_in("more", 1), "more: this key is not known"),
        (set_in("figures", 0, "value", "1e400"), "finite"),
    ],
)
def test_inconsistent_result_is_refused(
    folder: Path, board: Path, change: Callable[[dict[str, Any]], None], message: str
) -> None:
    plain = result()
    change(plain)
    before = sorted(board.rglob("*"))
    with pytest.raises(RefusedError, match=message):
        add_result(write(folder, plain), board, "a street")
    assert sorted(board.rglob("*")) == before


def test_other_version_of_the_protocol_is_refused(folder: Path, board: Path) -> None:
    plain = result()
    plain["protocol"]["masks"]["ego"] = False
    other = PROTOCOL.model_validate(plain["protocol"]).hash
    plain["protocol_hash"] = plain["submission"]["protocol_hash"] = other
    with pytest.raises(RefusedError, match=f"is not the board's version {PROTOCOL.version}"):
        add_result(write(folder, plain), board, "a street")
    plain["protocol"]["name"] = plain["submission"]["protocol"] = "own"
    own = PROTOCOL.model_validate(plain["protocol"]).hash
    plain["protocol_hash"] = plain["submission"]["protocol_hash"] = own
    with pytest.raises(RefusedError, match="unknown protocol 'own'"):
        add_result(write(folder, plain), board, "a street")


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, '{"figures": NaN}', "null", "\udce9"])
def test_no_json(folder: Path, board: Path, text: str) -> None:
    path = folder / "result.json"
    path.write_bytes(text.encode(errors="surrogateescape"))
    with pytest.raises(MirrorError, match=r"result\.json"):
        add_result(path, board, "a street")


def test_missing_files(folder: Path, board: Path) -> None:
    with pytest.raises(DatasetError, match="cannot be read"):
        add_result(folder / "none.json", board, "a street")
    path = write(folder, result())
    (folder / "images.parquet").write_bytes(b"PAR1")
    with pytest.raises(DatasetError, match=r"images\.parquet: cannot be read"):
        add_result(path, board, "a street")
    (folder / "images.parquet").unlink()
    with pytest.raises(DatasetError, match=r"images\.parquet: cannot be read"):
        add_result(path, board, "a street")


def test_costs(folder: Path, board: Path) -> None:
    protocol = load_protocol("runtime")
    plain = result()
    plain["protocol"] = protocol.model_dump(mode="json")
    plain["protocol_hash"] = plain["submission"]["protocol_hash"] = protocol.hash
    plain["submission"]["protocol"] = "runtime"
    rate = {"metric": "frames_per_second", "unit": "Hz", "better": "higher", "n": 1, "note": "on a processor"}
    plain["figures"] = [{**rate, "group": "reported", "value": 50.0}, {**rate, "group": "measured", "value": 40.0}]
    plain["unavailable"] = {"training_s": "state it"}
    pq.write_table(pa.table({}), folder / "images.parquet")
    with pytest.raises(RefusedError, match="was not done here"):
        add_result(write(folder, plain), board, "a street")
    del plain["figures"][1]
    add_result(write(folder, plain), board, "a street")
    (entry,) = [entry for entry in load_entries(board / "entries") if entry.method == "a method"]
    figures = {(figure.group, figure.metric): figure.value for figure in entry.figures}
    assert figures == {("reported", "frames_per_second"): 50.0, ("reported", "training_s"): None}


def test_means_of_all_groups_together(folder: Path, board: Path) -> None:
    protocol = load_protocol("editing-accuracy")
    plain = result()
    plain["protocol"] = protocol.model_dump(mode="json")
    plain["protocol_hash"] = plain["submission"]["protocol_hash"] = protocol.hash
    plain["submission"]["protocol"] = protocol.name
    values = {"left-1m": [0.2, 0.4], "right-1m": [0.6, None]}
    rows = [
        {"group": group, "scene_id": "s", "traversal_id": "t", "edit_iou_hull": value}
        for group, group_values in values.items()
        for value in group_values
    ]
    pq.write_table(pa.Table.from_pylist(rows), folder / "images.parquet")
    shared = {"metric": "edit_iou_hull", "better": "higher"}
    plain["figures"] = [
        {**shared, "group": "left-1m", "value": 0.3, "n": 2},
        {**shared, "group": "right-1m", "value": 0.6, "n": 2, "n_missing": 1},
        {**shared, "group": "all", "value": 0.45, "n": 4, "n_missing": 1},
    ]
    plain["unavailable"] = {}
    # Each group counts equally: 0.4 is the mean of all images.
    plain["figures"][2]["value"] = 0.4
    with pytest.raises(RefusedError, match=r"edit_iou_hull of all is 0\.4,"):
        add_result(write(folder, plain), board, "a street")
    overall = plain["figures"].pop()
    with pytest.raises(RefusedError, match=r"edit_iou_hull of all is missing"):
        add_result(write(folder, plain), board, "a street")
    plain["figures"].append({**overall, "value": 0.45})
    add_result(write(folder, plain), board, "a street")


def test_commands(folder: Path, board: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = str(write(folder, result()))
    options = ["--dataset-name", "a street", "--board", str(board)]
    # The dataset does not exist.
    assert main(["leaderboard", "add", path, str(tmp_path / "none"), *options]) == ExitCode.COULD_NOT_RUN
    assert main(["leaderboard", "add", str(tmp_path / "none"), str(tmp_path), *options]) == ExitCode.COULD_NOT_RUN
    hidden = ["--hidden", str(tmp_path)]
    assert main(["leaderboard", "add", path, str(tmp_path), *options, *hidden]) == ExitCode.COULD_NOT_RUN
    assert "--hidden requires --submission" in capsys.readouterr().err
    add_result(Path(path), board, "a street")
    build = ["leaderboard", "build", "--board", str(board), "--out", str(tmp_path / "site")]
    assert main(build) == ExitCode.FINDINGS
    assert "refused" in capsys.readouterr().err
    key = str(tmp_path / "organiser.key")
    assert main(["leaderboard", "sign", "--board", str(board), "--key", key]) == ExitCode.DONE
    assert "signed: 1 entry\n" in capsys.readouterr().out
    assert main(build) == ExitCode.DONE
    assert "a method" in (tmp_path / "site" / "index.html").read_text()
    capsys.readouterr()
    assert main(["leaderboard", "key", "--out", key]) == ExitCode.COULD_NOT_RUN
    said = capsys.readouterr()
    assert said.out == "" and "replaced by `mirror leaderboard rotate`" in said.err
    assert main(["leaderboard", "key", "--out", str(tmp_path / "new.key")]) == ExitCode.DONE
    assert main(["leaderboard"]) == ExitCode.COULD_NOT_RUN
    assert main(["leaderboard", "--help"]) == ExitCode.DONE


def test_result_hash_covers_the_whole_document(folder: Path, board: Path) -> None:
    path = add_result(write(folder, result()), board, "a street")
    entry = json.loads(path.read_text())
    # By definition, the hash of the canonical JSON of the whole document with its defaults.
    from mirror.evaluation.result import Result

    plain = Result.model_validate(result()).model_dump(mode="json")
    assert entry["result_hash"] == sha256_bytes(json.dumps(plain, sort_keys=True, separators=(",", ":")).encode())


def test_values_of_scenes_are_kept_and_held_against_the_table(folder: Path, board: Path) -> None:
    values = {"a": [0.2, 0.4], "b": [0.9]}
    rows = [
        {"group": "novel", "scene_id": scene, "traversal_id": scene, "matched_structure": value}
        for scene, scores in values.items()
        for value in scores
    ]
    pq.write_table(pa.Table.from_pylist(rows), folder / "images.parquet")
    plain = result()
    shared = {"metric": "matched_structure", "group": "novel", "better": "higher"}
    plain["figures"] = [{**shared, "value": 0.6, "n": 3, "interval_reason": "few"}]
    plain["clusters"] = [
        {"key": "a", "value": 0.3, "weight": 0.5, "n": 2},
        {"key": "b", "value": 0.9, "weight": 0.5, "n": 1},
    ]
    for change in (
        set_in("clusters", 0, "value", 0.5),
        set_in("clusters", 1, "n", 2),
        set_in("clusters", 0, "key", "c"),
    ):
        changed = json.loads(json.dumps(plain))
        change(changed)
        with pytest.raises(RefusedError, match="means of clusters"):
            add_result(write(folder, changed), board, "a street")
    add_result(write(folder, plain), board, "a street")
    (entry,) = [entry for entry in load_entries(board / "entries") if entry.method == "a method"]
    assert isinstance(entry, Measured)
    assert [one.model_dump() for one in entry.clusters] == plain["clusters"]
