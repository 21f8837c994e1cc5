"""The study from recordings to the tables of the page, at a tiny size: every stage runs, resumes, and is hashed."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from benchmarks.studies.closed_loop.declaration import load_declaration
from benchmarks.studies.closed_loop.driving import exact_percept
from benchmarks.studies.closed_loop.records import Records, RolloutKey
from benchmarks.studies.closed_loop.report import BEGIN, END, PAGE, format_report, update_page
from benchmarks.studies.closed_loop.scenarios import Case
from benchmarks.studies.closed_loop.sheets import write_sheets
from benchmarks.studies.closed_loop.stages import (
    choose_plan,
    is_finished,
    list_stages,
    planned_rollouts,
    run_count,
    run_stages,
)
from benchmarks.studies.closed_loop.streets import LIGHTS, Light
from benchmarks.studies.closed_loop.study import Study
from hybridworldsim.simulator.simulation import start_simulation
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError, UsageError
from mirror.progress import NullProgress
from mirror.schema.behaviours import HardBrake
from mirror.schema.scenario import PoseStart
from tests.benchmarks.studies.closed_loop.tiny import tiny_study


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory, tiny_dataset: Dataset) -> Iterator[Study]:
    made = tiny_study(tmp_path_factory.mktemp("closed_loop"), tiny_dataset)
    assert run_stages(made, NullProgress()) == 0
    yield made


def test_the_declaration_is_of_3000_rollouts_within_the_budget() -> None:
    declaration = load_declaration()
    assert len(declaration.policies) == 12 and len(declaration.scenarios["names"]) == 10
    worlds = [*declaration.worlds, *declaration.reconstruction["methods"]]
    assert len(declaration.policies) * 10 * len(declaration.scenarios["seeds"]) * len(worlds) == 3000
    fresh = Study(Path("absent"), declaration, Records(Path("absent.jsonl"), declaration.hash))
    stages = list_stages(fresh)
    assert sum(stage.core_minutes for stage in stages) <= 60.0 * declaration.budget["core_hours"]
    # Triggers are tuned before anything is driven, with seeds that are not driven.
    names = [stage.name for stage in stages]
    assert names.index("pilot") < names.index("triggers") < names.index("drive-exact")
    assert not set(declaration.triggers["seeds"]) & set(declaration.scenarios["seeds"])
    assert set(declaration.triggers["policies"]) <= set(declaration.policies)
    # Two of the 14 policies read no image, and drive two seeds.
    assert run_count(fresh, fresh.plan()) == 12 * 10 * 5 + 2 * 10 * 2
    # Both lights are driven in both streets, and no training street is one of them.
    assert {(case.street, case.light) for case in fresh.cases(range(4))} == {
        (street, light) for street in (0, 1) for light in ("day", "night")
    }
    assert not set(declaration.streets["seeds"]) & {*declaration.images["seeds"], declaration.images["validation_seed"]}


def test_every_stage_is_recorded_and_policies_without_images_drive_the_same_everywhere(study: Study) -> None:
    assert all(is_finished(study, stage) for stage in list_stages(study))
    text = format_report(study)
    assert "Not run" not in text
    assert "2 of 2 logs are equal to the bit" in text
    for key in planned_rollouts(study, "vanilla_3dgs"):
        own, exact = study.records.rollouts[key], study.records.rollouts[replace(key, world="exact")]
        # Networks see other images, so that they err otherwise.
        assert (own["offset_error_m"] == exact["offset_error_m"]) == (key.policy in ("blind", "privileged"))


def test_a_new_process_continues_with_the_records(study: Study) -> None:
    lines = study.records.file.read_text()
    again = Study(study.folder, study.declaration, Records(study.records.file, study.declaration.hash))
    assert run_stages(again, NullProgress()) == 0
    assert study.records.file.read_text() == lines
    assert again.records.core_s == pytest.approx(study.records.core_s)


def test_rollouts_of_another_network_do_not_count(study: Study, tmp_path: Path) -> None:
    lines = [json.loads(line) for line in study.records.file.read_text().splitlines()]
    for line in lines:
        if line.get("stage") == "perception":
            line["figures"]["networks"]["full"]["hash"] = "another"
    file = tmp_path / "outcomes.jsonl"
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))
    other = Study(study.folder, study.declaration, Records(file, study.declaration.hash))
    left = {stage.name for stage in list_stages(other) if not is_finished(other, stage)}
    assert left == {"drive-exact", "drive-exact-again", "drive-vanilla_3dgs"}
    assert other.is_current(RolloutKey("exact", "strong", "hard-brake", 0))
    assert not other.is_current(RolloutKey("exact", "full", "hard-brake", 0))
    assert "| 0 | - |" not in format_report(study)


def test_a_withdrawn_rollout_does_not_count(study: Study, tmp_path: Path) -> None:
    file = tmp_path / "outcomes.jsonl"
    file.write_text(study.records.file.read_text())
    other = Study(study.folder, study.declaration, Records(file, study.declaration.hash))
    key = RolloutKey("exact", "full", "hard-brake", 0)
    assert other.is_current(key)
    other.records.withdraw(key, "its street was not recorded")
    assert not other.is_current(key)
    assert {stage.name for stage in list_stages(other) if not is_finished(other, stage)} == {"drive-exact"}
    assert other.records.core_s == study.records.core_s
    assert "Not run: drive-exact." in format_report(other)


@pytest.mark.parametrize("light", LIGHTS)
def test_scenarios_start_where_the_drive_of_their_light_recorded(light: Light) -> None:
    declaration = load_declaration()
    study = Study(Path("absent"), declaration, Records(Path("absent.jsonl"), declaration.hash))
    # The longest lane of this street crosses the recorded one.
    case = Case("hard-brake", 0, 0, light)
    start = study.scenario(case, 1.0).ego.start
    assert isinstance(start, PoseStart)
    (recording,) = study.place(case).street.recordings.values()
    away = np.hypot(recording.poses[:, 0] - start.x_m, recording.poses[:, 1] - start.y_m)
    turn = math.radians(start.yaw_deg) - recording.poses[away.argmin(), 2]
    assert away.min() < declaration.scenarios["start_offset_m"] + 1.0
    assert abs(math.remainder(turn, math.tau)) < math.radians(declaration.scenarios["start_yaw_deg"] + 3.0)


def test_scenarios_vary_by_seed_and_their_triggers_by_the_scale(study: Study) -> None:
    declared = study.declaration.scenarios
    first, second = study.cases([0, 1])
    one, half, other = study.scenario(first, 1.0), study.scenario(first, 0.5), study.scenario(second, 1.0)
    assert one == study.scenario(first, 1.0) and one.ego == half.ego != other.ego
    behaviours = [scenario.agents[0].behaviour for scenario in (one, half)]
    assert all(isinstance(behaviour, HardBrake) for behaviour in behaviours)
    ttc = [behaviour.trigger.ttc_s for behaviour in behaviours if isinstance(behaviour, HardBrake)]
    assert ttc[1] == pytest.approx(0.5 * ttc[0], abs=1e-3)
    # The exact percept at the start is the declared displacement.
    for scenario in (one, other):
        simulation = start_simulation(study.place(first).street, scenario)
        seen = exact_percept(simulation.observe({}, privileged=True), simulation.observation_spec({}), study.settings)
        assert 0.0 < abs(seen.offset_m) <= declared["start_offset_m"] + 0.05
        assert 0.0 < abs(seen.heading_rad) <= math.radians(declared["start_yaw_deg"]) + 0.05


def test_another_declaration_is_refused(study: Study) -> None:
    with pytest.raises(UsageError, match="made under the declaration"):
        Records(study.records.file, "0" * 64)


def test_processes_share_the_records(tmp_path: Path) -> None:
    file = tmp_path / "outcomes.jsonl"
    first, second = Records(file, "a" * 64), Records(file, "a" * 64)
    first.add_stage("one", 2.0, {"value": 1})
    second.add_stage("two", 3.0, {"value": 2})
    with file.open("a") as unfinished:
        unfinished.write('{"declaration"')
    first.refresh()
    assert set(first.stages) == set(second.stages) == {"one", "two"}
    assert first.core_s == second.core_s == 5.0
    file.write_text(file.read_text() + "\n")
    with pytest.raises(DatasetError, match="line 3"):
        first.refresh()


def test_one_stage_and_the_budget(study: Study, tiny_dataset: Dataset, tmp_path: Path) -> None:
    fresh = tiny_study(tmp_path, tiny_dataset)
    stages = len(list_stages(fresh))
    assert run_stages(fresh, NullProgress(), hours=0.01) == stages
    assert run_stages(fresh, NullProgress(), only="street-0") == stages - 1
    with pytest.raises(UsageError, match="no stage"):
        run_stages(fresh, NullProgress(), only="street")


def test_an_estimate_over_the_budget_cuts_seeds_and_then_the_last_method(study: Study) -> None:
    pilot = study.records.stages["pilot"]
    assert (pilot["seeds"], pilot["methods"]) == ([0], ["vanilla_3dgs"])
    declared = study.declaration
    fixed_h = choose_plan(study, {"exact_s": 0.0, "reconstructed_s": 0.0})["estimate_h"]
    two = replace(
        study,
        declaration=replace(
            declared,
            scenarios={**declared.scenarios, "seeds": [0, 1]},
            budget={**declared.budget, "core_hours": fixed_h + 0.2, "fewer_seeds": [0]},
        ),
    )
    # Six rollouts with two seeds in each of three worlds: 2 policies with both, 2 references with the first.
    for rollout_s, seeds, methods in ((35.0, [0, 1], 1), (50.0, [0], 1), (70.0, [0], 0)):
        plan = choose_plan(two, {"exact_s": rollout_s, "reconstructed_s": rollout_s})
        assert (plan["seeds"], len(plan["methods"])) == (seeds, methods)
    assert choose_plan(two, {"exact_s": 25.0, "reconstructed_s": 50.0})["estimate_h"] == pytest.approx(
        fixed_h + 6 * (2 * 25.0 + 50.0) / 3600.0, abs=0.01
    )


def test_sheets_show_the_exact_world_above_the_reconstructed_one(study: Study, tmp_path: Path) -> None:
    (path,) = write_sheets(study, tmp_path)
    assert path.name == "hard-brake-day.png"
    sheet = cv2.imread(str(path)).astype(float)
    assert sheet.shape == (2 * 27, 6 * 48, 3)
    # The first column is the start: the same place, sky above and road below.
    first = sheet[:, :48].reshape(2, 27, 48, 3)
    assert 0.0 < np.abs(first[0] - first[1]).mean() < 128.0


def test_page_has_markers_and_gets_the_section(study: Study, tmp_path: Path) -> None:
    assert BEGIN in PAGE.read_text() and END in PAGE.read_text()
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n")
    update_page(study, page)
    assert page.read_text() == f"before\n{format_report(study)}\nafter\n"
    page.write_text("nothing")
    with pytest.raises(UsageError, match="no place"):
        update_page(study, page)
