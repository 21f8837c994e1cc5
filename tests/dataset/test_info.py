"""``mirror info``: what a path is."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mirror.cli.main import main
from mirror.dataset.index import build_index
from mirror.dataset.splits import make_split
from mirror.errors import DatasetError, SchemaError
from mirror.integrity.summary import summarise
from mirror.schema.documents import NovelTraversal
from mirror.schema.tables import BOXES
from tests.builders.dataset import EPOCH, SECOND, Builder, Pass, box


@pytest.fixture
def builder(tmp_path: Path) -> Builder:
    made = Builder(tmp_path, cameras=("front_wide", "rear"))
    made.scene("a")
    made.scene("b", longitude_deg=-80.0)
    for number in range(2):
        (name,) = made.drive(
            f"d{number}", [Pass("a", EPOCH + 100 * number * SECOND, frames=3)], vehicle_id="v", refused=number
        )
    made.layer(name, "boxes", "petr@1", BOXES, [box(EPOCH + 100 * SECOND, "t")])
    make_split(tmp_path, "s", NovelTraversal(train=1))
    return made


def test_a_dataset_in_brief(builder: Builder) -> None:
    found = summarise(builder.root)
    assert found.scenes == {"a": 2, "b": 0}
    assert (found.drives, found.traversals, found.images, found.image_bytes) == (2, 2, 12, 12_000)
    assert found.vehicles == {"v": 2}
    assert found.rigs == {"rig": ("front_wide", "rear")}
    assert found.passes == {"accepted": 2, "min_duration": 1}
    assert found.layers == {"boxes/petr@1": 1}
    assert sorted(found.splits["s"].items()) == [("held_out", 1), ("train", 1)]
    assert (found.first_ns, found.last_ns) == (EPOCH, EPOCH + 100 * SECOND + 3 * SECOND // 10)
    assert found.hours == pytest.approx(2 * 0.3 / 3600)
    assert found.problems == ()


def test_the_state_of_the_index(builder: Builder) -> None:
    assert summarise(builder.root).index == "missing"
    build_index(builder.root)
    assert summarise(builder.root).index == "current"
    builder.drive("d2", [Pass("a", EPOCH + 900 * SECOND)], vehicle_id="w")
    assert summarise(builder.root).index == "stale"


def test_what_is_broken_is_said(builder: Builder, capsys: pytest.CaptureFixture[str]) -> None:
    (builder.root / "rigs" / "rig.json").write_text("{")
    assert main(["info", str(builder.root)]) == 0
    out = capsys.readouterr().out
    assert "1 file: run `mirror check`" in out
    assert "rigs/rig.json" in out
    (builder.root / "dataset.json").write_text("{")
    with pytest.raises(SchemaError):
        summarise(builder.root)
    with pytest.raises(DatasetError, match="not a dataset"):
        summarise(builder.root / "rigs")


def test_the_verb_on_a_dataset(builder: Builder, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(builder.root)]) == 0
    out = capsys.readouterr().out
    assert "is a dataset" in out
    assert "missing: run `mirror index`" in out
    assert "2023-11-14 to 2023-11-14, 0.00 hours of traversals" in out
    assert main(["info", str(builder.root), "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert (plain["kind"], plain["traversals"], plain["document"]["trigger"]["min_path_m"]) == ("dataset", 2, 20.0)


def test_the_verb_on_a_recording(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "track.csv"
    rows = [f"2021-06-07T12:00:{second:02}Z,{10 + second * 1e-4:.6f},50.0" for second in range(30)]
    file.write_text("\n".join(["time,longitude,latitude", *rows, "2021-06-07T12:01:00Z,1555.0,50.0"]) + "\n")
    assert main(["info", str(file), "--reader", "csv"]) == 0
    out = capsys.readouterr().out
    assert "is a recording" in out
    assert "31 (30 usable)" in out
    assert "10.000000 to 10.002900" in out
    assert main(["info", str(file), "--reader", "csv", "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert (plain["kind"], plain["poses"], plain["rig_id"]) == ("recording", 31, None)


def test_the_verb_on_real_recordings(real_data: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(real_data / "dgp_scene_02"), "--json"]) == 0
    plain = json.loads(capsys.readouterr().out)
    assert len(plain["cameras"]) == 6
    assert {camera["images"] for camera in plain["cameras"].values()} == {3}
    assert {round(camera["rate_hz"]) for camera in plain["cameras"].values()} == {10}
    assert plain["boxes"] == 39


def test_nothing_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["info", str(tmp_path / "none")]) == 2
    assert "there is no file or folder at this path" in capsys.readouterr().err
    assert main(["info", str(tmp_path)]) == 2
