"""The shipped protocols are valid, and their hashes identify their content."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

import pytest

from mirror.errors import SchemaError, UsageError
from mirror.evaluation.scorers import TASKS, load_scorer
from mirror.protocols.document import Protocol, load_protocol, parse_protocol, protocol_names, read_definition
from tests.evaluation.submissions import small


@pytest.mark.parametrize("name", protocol_names())
def test_shipped_protocol_is_valid(name: str) -> None:
    protocol = load_protocol(name)
    assert protocol.name == name
    # Rollouts are no renders of views: mirror.evaluation.rollouts scores them.
    if protocol.task != "safety":
        assert load_scorer(protocol.task).version >= 1
        assert set(TASKS) >= {protocol.task}


def test_shipped_names() -> None:
    wanted = "static-reconstruction lane-shift vehicle-translation generation editing-accuracy annotation runtime"
    assert {*wanted.split(), "safety"} <= set(protocol_names())
    with pytest.raises(UsageError, match="static-reconstruction"):
        load_protocol("static")


def test_shifts_are_declared() -> None:
    lanes = {group.name: group.ego_shift_m for group in load_protocol("lane-shift").groups}
    assert lanes == {f"{side}-{m}m": sign * m for side, sign in (("left", 1.0), ("right", -1.0)) for m in (1, 2, 3)}
    cars = [group.vehicle_shift_m for group in load_protocol("vehicle-translation").groups]
    assert cars == [-3.0, -2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0, 3.0]


def test_hash_ignores_description_and_layout() -> None:
    text = files("mirror.protocols").joinpath("definitions/static-reconstruction.toml").read_text()
    protocol = parse_protocol(text.encode(), "a.toml")
    same = text.replace("Novel-view", "New-view").replace("every = 5", "every   =   5")
    reworded = parse_protocol(same.encode(), "b")
    other = parse_protocol(text.replace("every = 5", "every = 4").encode(), "c")
    assert reworded.description != protocol.description
    assert reworded.hash == protocol.hash != other.hash
    assert Protocol.model_validate_json(protocol.model_dump_json()).hash == protocol.hash


@pytest.mark.parametrize(
    ("old", "new", "place"),
    [
        ("every = 5", "every = 0", "frames.every"),
        ("every = 5", "evry = 5", "frames.every, frames.evry"),
        ('space = "undistorted"', 'space = "flat"', "pixels.space"),
        ("[masks]", "[masks]\ncolour = 1", "masks.colour"),
        ('metric = "psnr"', 'metric = "psn"', "metrics.1"),
        ('name = "training"', 'name = "../up"', "groups.0.name"),
        ('name = "training"', 'name = "novel"', "the whole protocol"),
        ("[masks]", "[masks", None),
    ],
)
def test_wrong_key_is_named(old: str, new: str, place: str | None) -> None:
    text = files("mirror.protocols").joinpath("definitions/static-reconstruction.toml").read_text()
    with pytest.raises(SchemaError) as caught:
        parse_protocol(text.replace(old, new).encode(), "mine.toml")
    assert caught.value.file == "mine.toml"
    assert caught.value.place == place


def test_edited_group_needs_vehicles() -> None:
    with pytest.raises(SchemaError, match="vehicles"):
        small(groups='[[groups]]\nname = "a"\nroles = ["train"]\nvehicle_shift_m = 1.0\n')


def test_hashes_of_shipped_protocols_are_unchanged() -> None:
    # Results contain these hashes. A change of the measurement needs a higher version and its new hash here.
    assert {(name, load_protocol(name).version): load_protocol(name).hash[:8] for name in protocol_names()} == {
        ("annotation", 2): "c4cbb638",
        ("closed-loop", 1): "d06a5ee4",
        ("closed-loop-mini", 1): "c712b090",
        ("closed-loop-robust", 1): "7ab7634e",
        ("editing-accuracy", 2): "0c21f36d",
        ("editing-accuracy-small", 2): "b6f4d7c2",
        ("generation", 2): "8417feae",
        ("lane-shift", 4): "76228b49",
        ("runtime", 1): "c0001232",
        ("safety", 2): "e345a3ae",
        ("static-reconstruction", 4): "2be5e6e1",
        ("static-reconstruction-omnire", 2): "abfb52d3",
        ("static-reconstruction-unmasked", 2): "cb674702",
        ("vehicle-translation", 2): "03c094f8",
    }


def test_the_unmasked_protocol_differs_in_nothing_else() -> None:
    masked, unmasked = load_protocol("static-reconstruction"), load_protocol("static-reconstruction", masked=False)
    changed = {name for name in Protocol.model_fields if getattr(masked, name) != getattr(unmasked, name)}
    assert changed == {"name", "version", "description", "masks"}
    assert unmasked.masks == masked.masks.model_copy(update={"dynamic": ()})
    assert load_protocol("generation", masked=False) == load_protocol("generation")


@pytest.mark.parametrize("name", ["lane-shift", "mine.toml"])
def test_a_protocol_without_an_unmasked_twin_is_named(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.toml").write_bytes(read_definition("static-reconstruction"))
    with pytest.raises(UsageError) as caught:
        load_protocol(name, masked=False)
    assert caught.value.place == "--no-masks"
    assert name in str(caught.value) and "dynamic = []" in str(caught.value.remedy)
