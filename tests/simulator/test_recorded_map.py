"""Rollouts in a dataset drive on its recorded map, or on a fitted one, and say which."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mirror
from hybridworldsim.simulator.ego.vehicle import VehicleParameters
from hybridworldsim.simulator.simulation import start_simulation
from hybridworldsim.simulator.street.opening import open_street
from mirror.cli.main import main
from mirror.errors import DatasetError, UsageError
from mirror.evaluation.result import RESULT, Result
from mirror.ingest.request import IngestOptions
from mirror.ingest.run import ingest_recordings
from mirror.schema.files import read_json
from mirror.schema.road_map import MapLane, read_road_map, write_road_map
from mirror.schema.rollout import MAP_FILE, STATES_FILE, read_rollout
from mirror.schema.scenario import Scenario, write_scenario
from tests.builders.folder import SCENE, write_recording
from tests.ingest.maps import east_map

HALF_M = 0.5 * VehicleParameters().width_m


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two datasets of one recording, ``fitted`` without a map and ``recorded`` with one, a map and a scenario."""
    root = tmp_path_factory.mktemp("maps")
    recording = write_recording(root, "east")
    write_road_map(root / "map.parquet", east_map())
    for name, maps in (("fitted", ()), ("recorded", (root / "map.parquet",))):
        ingest_recordings([recording], [SCENE], root / name, IngestOptions(workers=1, maps=maps))
    start = {"start": {"kind": "recorded"}}
    write_scenario(root / "short.toml", Scenario.model_validate({"name": "short", "duration_s": 1.0, "ego": start}))
    return root


@pytest.mark.parametrize(
    ("dataset", "options", "source", "margin_m"),
    [
        # The ego drives in the middle: of a road of 8 m, and of an area 2.125 m to either side of the driven line.
        ("recorded", [], "dataset", 4.0 - HALF_M),
        ("fitted", [], "fitted", 2.125 - HALF_M),
        ("fitted", ["--map", "map.parquet"], "file", 4.0 - HALF_M),
    ],
)
def test_a_rollout_says_which_map_it_drove_on(
    dataset: str, options: list[str], source: str, margin_m: float, folder: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(folder)
    out = tmp_path / "run"
    drive = ["simulate", dataset, "--scenario", "short.toml", "--policy", "constant-velocity", "--no-video", "--json"]
    assert main([*drive, *options, "--out", str(out)]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["road_map"] == source == read_rollout(out).map_source
    assert printed["safety"]["drivable_margin"] == pytest.approx(margin_m, abs=0.005)
    assert read_road_map(out / MAP_FILE).fitted == (source == "fitted")
    if source != "fitted":
        assert (out / MAP_FILE).read_bytes() == (folder / "map.parquet").read_bytes()
    assert main(["evaluate", str(out), "--protocol", "safety", "--out", str(tmp_path / "scores")]) == 0
    result = read_json(tmp_path / "scores" / RESULT, Result)
    assert result.options["road_map"] == source
    assert ("lower bounds" in " ".join(result.warnings)) == (source == "fitted")


def test_a_rollout_is_repeated_in_its_dataset_and_no_other(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    out, again = tmp_path / "run", tmp_path / "again"
    drive = ["simulate", "fitted", "--scenario", "short.toml", "--policy", "constant-velocity", "--no-video"]
    assert main([*drive, "--out", str(out)]) == 0
    repeat = ["--replay", str(out), "--no-video", "--out", str(again)]
    made, other = read_rollout(out).dataset_hash, mirror.open(folder / "recorded").index_sha256
    for source, reason in (
        (["recorded"], f"made with the dataset {made}; this street has the dataset {other}"),
        (["fitted", "--map", "map.parquet"], "made with the road map of this file (fitted); this street has another"),
    ):
        capsys.readouterr()
        assert main(["simulate", *source, *repeat]) == 2
        assert reason in capsys.readouterr().err
        assert not again.exists()
    lost = Scenario.model_validate({"name": "lost", "ego": {"route": {"lanes": ["nowhere"]}}})
    write_scenario(tmp_path / "lost.toml", lost)
    assert main([*drive, "--scenario", str(tmp_path / "lost.toml"), "--out", str(again)]) == 2
    assert f"{tmp_path / 'lost.toml'}: ego.route.lanes: there is no lane 'nowhere'" in capsys.readouterr().err
    assert main(["simulate", "fitted", *repeat]) == 0
    assert "bit for bit" in capsys.readouterr().out
    later = ["--from", str(out), "--no-video", "--out", str(tmp_path / "later"), "--policy", "constant-velocity"]
    for source, options, reason in (
        (["recorded"], ["--at", "0.5"], "--from: the rollout was made with the dataset"),
        (["fitted"], ["--at", "0.5", "--renderer", "exact"], "--renderer: the drive of"),
        (["fitted"], ["--at", "1"], "--at: 1 s is no instant from which it can go on"),
        (["fitted"], ["--at", "0.5", "--scenario", "short.toml"], "--from: it has its own scenario"),
        (["fitted"], [], "--from: no policy, or no instant"),
    ):
        assert main(["simulate", *source, *later, *options]) == 2
        assert reason in capsys.readouterr().err
        assert not (tmp_path / "later").exists()
    assert main(["simulate", "fitted", *later, "--at", "0.5"]) == 0
    assert (tmp_path / "later" / STATES_FILE).read_bytes() == (out / STATES_FILE).read_bytes()
    assert read_rollout(tmp_path / "later").policy == "constant-velocity after 0.5 s of constant-velocity"


def test_the_ego_starts_on_a_lane_that_was_driven(folder: Path, tmp_path: Path) -> None:
    """A longer lane beside the recorded line, there and back, is on the map but was not recorded."""
    road_map, x = east_map(), np.linspace(-50.0, 50.0, 11)
    there = np.column_stack([np.r_[x, x[::-1]], np.r_[np.full(11, 12.0), np.full(11, -12.0)], np.zeros(22)])
    other = MapLane("a-longer-one", "drive", there, np.full(22, 3.5))
    file = tmp_path / "map.parquet"
    write_road_map(file, replace(road_map, lanes={"a-longer-one": other, **road_map.lanes}))
    street = open_street(str(folder / "fitted"), road_map=file)
    assert street.is_driven(np.array([[0.0, 1.9], [0.0, 2.1], [500.0, 0.0]])).tolist() == [True, False, False]
    assert start_simulation(street, Scenario(name="anywhere")).route.lanes == ("only",)


def test_a_map_that_was_changed_or_is_of_another_scene_ends_the_drive(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.parquet"
    write_road_map(other, east_map("elsewhere"))
    with pytest.raises(UsageError, match="a map of scene elsewhere"):
        open_street(str(folder / "fitted"), road_map=other)
    stored = folder / "recorded" / "maps" / "street" / MAP_FILE
    data = stored.read_bytes()
    try:
        stored.write_bytes(data[:-1])
        open_street.cache_clear()
        with pytest.raises(DatasetError, match="not the file that was written"):
            open_street(str(folder / "recorded"))
    finally:
        stored.write_bytes(data)
