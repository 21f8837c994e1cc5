"""The stages of the study in their order, each with its budget.

A finished stage is a line of the records, and is not run again; recordings, images, networks and models that a later
stage needs and that are missing, as on another machine, are made again. Rollouts made with other networks or models
than the last ones do not count, and are driven again.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch

from benchmarks.studies.closed_loop.driving import NetworkPolicy
from benchmarks.studies.closed_loop.perception_images import PerceptionImages, make_perception_images, part_file
from benchmarks.studies.closed_loop.percepts import PerceptionNet
from benchmarks.studies.closed_loop.records import Figures, RolloutKey
from benchmarks.studies.closed_loop.rollouts import drive
from benchmarks.studies.closed_loop.scenarios import Case
from benchmarks.studies.closed_loop.study import PILOT, Plan, Study, model_hash, tuning_world
from benchmarks.studies.closed_loop.train_perception import (
    Training,
    measure_errors,
    read_network,
    train_network,
    write_network,
)
from benchmarks.studies.closed_loop.worlds import World, make_recordings, make_task, reconstruct
from hybridworldsim.methods.layers import has_estimated_points, layers_for
from mirror.errors import UsageError
from mirror.methods.model_document import DOCUMENT, read_reconstruction
from mirror.methods.plugin import ReconstructionTask
from mirror.progress import ProgressReporter
from mirror.schema.scenario import read_scenario

EXACT = "exact"


@dataclass(frozen=True)
class Stage:
    """A part of the study.

    Attributes:
        name: its name.
        core_minutes: its budget, from measured costs.
        run: does it, and returns its figures.
        needs: stages whose files it reads.
        is_made: whether its files are there; of a stage without files, always.
    """

    name: str
    core_minutes: float
    run: Callable[[Study, ProgressReporter], Figures]
    needs: tuple[str, ...] = ()
    is_made: Callable[[Study], bool] = lambda study: True


def list_stages(study: Study) -> list[Stage]:
    """Return all stages in their order."""
    declared, plan = study.declaration, study.plan()
    seeds = declared.streets["seeds"]
    streets = tuple(f"street-{seed}" for seed in seeds)
    blocks = 2.0 * float(declared.reconstruction["core_minutes"])
    exact, reconstructed = _rollout_minutes(study)
    stages = [
        *(
            Stage(f"street-{seed}", 8.0, partial(_street, seed=seed), (), partial(_has_street, seed=seed))
            for seed in seeds
        ),
        Stage(PILOT, 4.0, _pilot, streets[:1]),
        Stage("images", 5.0, _images, (), _has_images),
        Stage("perception", 19.0, _perception, ("images",), _has_networks),
        Stage("triggers", 9.0, _triggers, ("perception",)),
        *(
            Stage(
                f"drive-{world}", exact * len(missing_rollouts(study, world)), partial(_drive, world=world),
                ("perception", "triggers"),
            )
            for world in declared.worlds
        ),
    ]  # fmt: skip
    for method in plan.methods:
        models = tuple(f"model-{method}-{seed}" for seed in seeds)
        stages += [
            Stage(
                name, blocks, partial(_model, method=method, seed=seed), (street,),
                partial(_has_model, method=method, seed=seed),
            )
            for name, street, seed in zip(models, streets, seeds)
        ]  # fmt: skip
        stages.append(
            Stage(
                f"drive-{method}",
                reconstructed * len(missing_rollouts(study, method)),
                partial(_drive, world=method),
                ("perception", "triggers", *models, *streets),
            )
        )
    return stages


def run_stages(study: Study, progress: ProgressReporter, *, only: str | None = None, hours: float | None = None) -> int:
    """Run the stages that are not finished, until the budget is used up.

    Args:
        study: the study.
        progress: receives the progress.
        only: name of one stage, which is run with what it needs; None: all.
        hours: core-hours after which no stage is begun, those of recorded ones included; None: the declaration's.

    Returns:
        The number of stages that are left.

    Raises:
        UsageError: there is no such stage.
    """
    names = [stage.name for stage in list_stages(study)]
    if only is not None and only not in names:
        raise UsageError(f"no stage {only!r}", expected=", ".join(names))
    torch.set_num_threads(int(study.declaration.training["threads"]))
    budget_s = 3600.0 * float(study.declaration.budget["core_hours"] if hours is None else hours)
    while True:
        # The pilot may shorten the list, and other processes may have finished stages.
        study.records.refresh()
        left = [stage for stage in list_stages(study) if not is_finished(study, stage)]
        chosen = [stage for stage in left if only in (None, stage.name)]
        if not chosen:
            return len(left)
        stage = chosen[0]
        if study.records.core_s + 60.0 * stage.core_minutes > budget_s:
            progress.message(f"{stage.name}: {stage.core_minutes:.0f} core-minutes are more than is left of the budget")
            return len(left)
        _run_with_needs(study, stage, progress)


def is_finished(study: Study, stage: Stage) -> bool:
    """Return whether a stage is recorded, and if it is of rollouts, whether all of them count."""
    if stage.name not in study.records.stages:
        return False
    world = stage.name.removeprefix("drive-")
    return world == stage.name or not missing_rollouts(study, world)


def _run_with_needs(study: Study, stage: Stage, progress: ProgressReporter) -> None:
    stages = {one.name: one for one in list_stages(study)}
    for name in stage.needs:
        if name not in study.records.stages or not stages[name].is_made(study):
            _run_with_needs(study, stages[name], progress)
    progress.message(f"{stage.name}: about {stage.core_minutes:.0f} core-minutes")
    begin = time.process_time()
    figures = stage.run(study, progress)
    # Trainings count their interrupted parts themselves, and rollouts have their own records.
    core_s = float(figures.pop("core_s", time.process_time() - begin))
    study.records.add_stage(stage.name, core_s, figures)


def run_count(study: Study, plan: Plan) -> int:
    """Return the number of rollouts in one world."""
    references = study.declaration.references
    seeds = len(set(references["seeds"]) & set(plan.seeds))
    policies = len(study.declaration.policies) * len(plan.seeds) + len(references["names"]) * seeds
    return len(study.declaration.scenarios["names"]) * policies


def planned_rollouts(study: Study, world: str) -> list[RolloutKey]:
    """List all rollouts in a world by seed.

    After an interruption, those that exist are then complete for some seeds.
    """
    declared, plan = study.declaration, study.plan()
    keys = []
    for case in study.cases(plan.seeds):
        names = list(declared.policies)
        if case.seed in declared.references["seeds"]:
            names += declared.references["names"]
        keys += [RolloutKey(world, name, case.scenario, case.seed) for name in names]
    return keys


def missing_rollouts(study: Study, world: str) -> list[RolloutKey]:
    """Return the planned rollouts in a world that are not recorded, or do not count."""
    planned = planned_rollouts(study, world)
    # Before the triggers are tuned nothing is driven.
    return [key for key in planned if not study.is_current(key)] if "triggers" in study.records.stages else planned


def _rollout_minutes(study: Study) -> tuple[float, float]:
    """Core-minutes of a rollout in the exact world and in a reconstructed one: the pilot's, or a guess before it."""
    figures = study.records.stages.get(PILOT, {"exact_s": 2.0, "reconstructed_s": 2.0})
    return figures["exact_s"] / 60.0, figures["reconstructed_s"] / 60.0


def _street(study: Study, progress: ProgressReporter, *, seed: int) -> Figures:
    make_recordings(study.street_folder(seed), study.declaration.streets, seed)
    layers_for(study.dataset(seed), _task(study, 1.0), progress)
    trained = study.dataset(seed).where(split=study.declaration.streets["split"], role="train")
    return {"traversals": len(trained.traversals()), "frames": len(trained.frames())}


def _has_street(study: Study, *, seed: int) -> bool:
    if not (study.street_folder(seed) / "dataset" / "splits").is_dir():
        return False
    task = _task(study, 1.0)
    # A layer that the declaration names in place of an estimator is part of the dataset.
    return "@" in str(task.initialise) or has_estimated_points(study.dataset(seed), task)


def _task(study: Study, core_minutes: float) -> ReconstructionTask:
    return make_task(study.declaration.streets, study.declaration.reconstruction, core_minutes)


def _pilot(study: Study, progress: ProgressReporter) -> Figures:
    """Time rollouts of an untrained network: half in the exact world, half in a model that was trained shortly."""
    declared = study.declaration
    seed, count = int(declared.streets["seeds"][0]), int(declared.budget["pilot_rollouts"]) // 2
    folder = study.folder / "models" / PILOT
    task = _task(study, float(declared.budget["pilot_core_minutes"]))
    trained = reconstruct(
        study.dataset(seed),
        declared.reconstruction["methods"][0],
        task,
        declared.reconstruction["block_m"],
        folder,
        progress,
    )
    torch.manual_seed(0)
    policy = NetworkPolicy(PerceptionNet().eval(), study.settings, declared.camera["name"])
    cases = [case for case in study.cases(range(2 * count)) if case.street == 0][:count]
    figures: Figures = {}
    begin = time.process_time()
    worlds: list[tuple[str, World]] = [
        (EXACT, study.worlds(EXACT)[0]),
        ("reconstructed", study.reconstructed(folder, seed)),
    ]
    for name, world in worlds:
        parts: dict[str, float] = {}
        progress.start(f"pilot, {name}", count)
        for case in cases:
            place = study.place(case)
            done = drive(policy, study.scenario(case, 1.0), place, world, study.settings, declared.report["horizon_s"])
            for part, seconds in done.seconds.items():
                parts[part] = parts.get(part, 0.0) + seconds / count
            progress.advance(1)
        figures[f"{name}_s"] = round(sum(parts.values()), 3)
        figures[f"{name}_parts_ms"] = {part: round(1e3 * seconds, 1) for part, seconds in parts.items()}
    core_s = trained["core_s"] + time.process_time() - begin
    return figures | {"gaussians": trained["gaussians"], "core_s": core_s} | choose_plan(study, figures)


def choose_plan(study: Study, figures: Figures) -> Figures:
    """Choose the first plan whose estimate is within the budget, or the last one."""
    declared = study.declaration
    methods, seeds = declared.reconstruction["methods"], declared.scenarios["seeds"]
    plans = [Plan(tuple(seeds), tuple(methods))]
    plans += [Plan(tuple(declared.budget["fewer_seeds"]), tuple(some)) for some in (methods, methods[:-1])]
    fixed = {
        stage.name: stage.core_minutes
        for stage in list_stages(study)
        if not stage.name.startswith(("drive-", "model-"))
    }
    a_model = 2.0 * float(declared.reconstruction["core_minutes"]) * len(declared.streets["seeds"])
    for plan in plans:
        exact, other = len(declared.worlds), len(plan.methods)
        runs_s = run_count(study, plan) * (exact * figures["exact_s"] + other * figures["reconstructed_s"])
        estimate = (sum(fixed.values()) + a_model * other) / 60.0 + runs_s / 3600.0
        if estimate <= float(declared.budget["core_hours"]):
            break
    return {"seeds": list(plan.seeds), "methods": list(plan.methods), "estimate_h": round(estimate, 2)}


def _images(study: Study, progress: ProgressReporter) -> Figures:
    data, held_out = _perception_data(study, progress)
    return {"images": len(data), "validation": len(held_out)}


def _perception_data(study: Study, progress: ProgressReporter) -> tuple[PerceptionImages, PerceptionImages]:
    declared = study.declaration
    data, held_out = (
        make_perception_images(
            study.vehicle, declared.images, declared.streets["preset"], study.settings.lookahead_m,
            study.folder / "images", progress, validation=validation,
        )
        for validation in (False, True)
    )  # fmt: skip
    return data, held_out


def _has_images(study: Study) -> bool:
    images, folder = study.declaration.images, study.folder / "images"
    return all(
        part_file(folder, site, drive, seed).is_file()
        for site in images["sites"]
        for drive in images["drives"]
        for seed in (*images["seeds"], images["validation_seed"])
    )


def _perception(study: Study, progress: ProgressReporter) -> Figures:
    declared = study.declaration
    data, held_out = _perception_data(study, progress)
    progress.start("training of perception", len(declared.policies))
    networks = {}
    for number, (name, values) in enumerate(declared.policies.items()):
        path = study.network_file(name)
        if not path.is_file():
            network = train_network(Training.declared(values), data, declared.training, study.settings.sight_m, number)
            write_network(path, network)
        network, digest = read_network(path)
        errors = measure_errors(network, held_out, study.settings.sight_m)
        networks[name] = {"hash": digest} | {
            key: round(value, 3) if math.isfinite(value) else None for key, value in errors.items()
        }
        progress.advance(1)
    return {"networks": networks}


def _has_networks(study: Study) -> bool:
    recorded = study.records.stages["perception"]["networks"]
    files = {name: study.network_file(name) for name in recorded}
    return all(file.is_file() and read_network(file)[1] == recorded[name]["hash"] for name, file in files.items())


def _triggers(study: Study, progress: ProgressReporter) -> Figures:
    """Choose for each scenario the scale with the share of events nearest to a half."""
    declared = study.declaration.triggers
    shares: dict[str, dict[str, float]] = {}
    cases = study.cases(declared["seeds"])
    world = study.worlds(EXACT)
    progress.start("tuning of triggers", len(cases) * len(declared["scales"]))
    for scale in declared["scales"]:
        for case in cases:
            if scale == declared["scales"][0] or _has_trigger(case.scenario):
                keys = [
                    RolloutKey(tuning_world(scale), name, case.scenario, case.seed) for name in declared["policies"]
                ]
                _drive_case(study, world[case.street], case, keys, scale)
            progress.advance(1)
    rollouts = study.records.rollouts
    for name in study.declaration.scenarios["names"]:
        for scale in declared["scales"]:
            events = [
                row["collision"] or row["off_road"]
                for key, row in rollouts.items()
                if (key.world, key.scenario) == (tuning_world(scale), name)
            ]
            if events:
                shares.setdefault(name, {})[f"{scale:g}"] = float(np.mean(events))
    scales = {name: float(min(found, key=lambda scale: abs(found[scale] - 0.5))) for name, found in shares.items()}
    overall = float(np.mean([shares[name][f"{scale:g}"] for name, scale in scales.items()]))
    return {"scales": scales, "shares": shares, "share": round(overall, 3), "core_s": 0.0}


def _has_trigger(scenario: str) -> bool:
    agents = read_scenario(scenario).agents
    return any(hasattr(agent.behaviour, name) for agent in agents for name in ("trigger", "ttc_s"))


def _drive(study: Study, progress: ProgressReporter, *, world: str) -> Figures:
    plan = study.plan()
    cases = study.cases(plan.seeds)
    keys, worlds = planned_rollouts(study, world), study.worlds(world)
    progress.start(f"rollouts, {world}", len(cases))
    for case in cases:
        own = [key for key in keys if (key.scenario, key.seed) == (case.scenario, case.seed)]
        _drive_case(study, worlds[case.street], case, own, study.scale(case.scenario))
        progress.advance(1)
    return {"rollouts": len(keys), "core_s": 0.0}


def _drive_case(study: Study, world: World, case: Case, keys: Sequence[RolloutKey], scale: float) -> None:
    """Drive and record the rollouts of a case in one world that are not recorded yet."""
    missing = [key for key in keys if not study.is_current(key)]
    if not missing:
        return
    place, scenario = study.place(case), study.scenario(case, scale)
    for key in missing:
        policy, network = study.policy(key.policy)
        row = drive(policy, scenario, place, world, study.settings, study.declaration.report["horizon_s"]).row
        study.records.add_rollout(key, {**row, "network": network, "model": world.model, "scale": scale})


def _model(study: Study, progress: ProgressReporter, *, method: str, seed: int) -> Figures:
    declared = study.declaration.reconstruction
    folder = study.model_folder(method, seed)
    task = _task(study, float(declared["core_minutes"]))
    figures = reconstruct(study.dataset(seed), method, task, declared["block_m"], folder, progress)
    return figures | {"hash": model_hash(folder)}


def _has_model(study: Study, *, method: str, seed: int) -> bool:
    folder = study.model_folder(method, seed)
    if not (folder / DOCUMENT).is_file() or read_reconstruction(folder).done is None:
        return False
    return model_hash(folder) == study.records.stages[f"model-{method}-{seed}"]["hash"]
