"""``mirror split`` as it is typed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mirror.cli.main import main
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass


@pytest.fixture
def builder(tmp_path: Path) -> Builder:
    made = Builder(tmp_path / "data", cameras=("front_wide",))
    made.scene("a")
    made.scene("b", longitude_deg=-80.0)
    for number in range(6):
        scene, light = ("a", "day") if number < 5 else ("b", "night")
        made.drive(
            f"d{number}", [Pass(scene, EPOCH + 100 * number * SECOND, frames=2, light=light)], vehicle_id=f"v{number}"
        )
    return made


def run(builder: Builder, capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    code = main(["split", str(builder.root), *words])
    said = capsys.readouterr()
    return code, said.out + said.err


def test_made_kept_and_extended(builder: Builder, capsys: pytest.CaptureFixture[str]) -> None:
    code, said = run(builder, capsys, "s")
    assert code == 0
    assert "held_out 1, train 4, unused 1" in said
    assert "left out: b: 1 traversal," in said
    builder.drive("late", [Pass("a", EPOCH + 9000 * SECOND, frames=2)], vehicle_id="late")
    code, said = run(builder, capsys, "s")
    assert code == 0
    assert "is unchanged" in said
    assert "1 traversal came after the split" in said
    code, said = run(builder, capsys, "s", "--extend", "--json")
    plain = json.loads(said)
    assert (code, plain["action"], plain["roles"]["train"]) == (0, "extended", 5)
    assert plain["split"]["parameters"]["method"] == "novel-traversal"


def test_every_method(builder: Builder, capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        run(builder, capsys, "n", "--train", "2", "--held-out-traversals", "2", "--seed", "3", "--scene", "a")[0] == 0
    )
    words = ["--method", "by-scene", "--train", "0.5", "--val", "0", "--test", "0.5"]
    assert run(builder, capsys, "bs", *words)[0] == 0
    code, said = run(
        builder, capsys, "c", "--method", "by-condition", "--train-on", "light=day", "--test-on", "weather=rain",
        "--test-on", "light=night,weather=clear",
    )  # fmt: skip
    assert (code, "test 1, train 5" in said) == (0, True)
    roles = json.loads((builder.root / "splits" / "n.json").read_text())["assignments"]
    first = next(key for key in roles if key.startswith("a."))
    code, said = run(builder, capsys, "l", "--method", "by-list", "--held-out-id", first)
    assert (code, "held_out 1, train 4, unused 1" in said) == (0, True)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["s", "--require"], "b: 1 traversal,"),
        (["s", "--val", "0.1"], "--val is not for --method novel-traversal"),
        (["s", "--train", "1.5"], "--train"),
        (["s", "--train", "0"], "--train: 0.0; expected a number greater than or equal to 1"),
        (["s", "--train", "9"], "ask for fewer with --train N --held-out-traversals M"),
        (
            ["s", "--method", "by-scene", "--val", "0.9", "--test", "0.9"],
            "mirror split: --train, --val, --test: the shares 0.7 + 0.9 + 0.9 add up to 2.5; expected 1. Remedy: ",
        ),
        (["s", "--method", "by-condition", "--train-on", "light=day"], "--test-on: no condition given"),
        (["s", "--method", "by-condition", "--train-on", "light=dawn"], "'light=dawn' is not a condition"),
        (["s", "--method", "by-condition", "--train-on", "light"], "'light' is not a condition"),
        (["s", "--extend"], "no such split. Remedy: make one with `mirror split"),
        (["s", "--extend", "--seed", "1"], "--extend and --seed exclude each other"),
        (["s", "--scene", "z"], "unknown scene 'z'"),
        (["../s"], "'../s' is not a valid name of a split"),
    ],
)
def test_wrong_use(builder: Builder, capsys: pytest.CaptureFixture[str], words: list[str], message: str) -> None:
    code, said = run(builder, capsys, *words)
    assert code == 2
    assert message in said
    assert not (builder.root / "splits").exists()
