"""The folder of the study, its records, and what its stages share."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import mirror
from benchmarks.studies.closed_loop.declaration import Declaration
from benchmarks.studies.closed_loop.driving import REFERENCES, ControllerSettings, NetworkPolicy, StudyPolicy
from benchmarks.studies.closed_loop.records import Figures, Records, RolloutKey
from benchmarks.studies.closed_loop.scenarios import Case, list_cases, make_scenario
from benchmarks.studies.closed_loop.streets import Place, Vehicle, open_place, vehicle_of
from benchmarks.studies.closed_loop.train_perception import read_network
from benchmarks.studies.closed_loop.worlds import ExactWorld, ReconstructedWorld, World
from hybridworldsim.methods.static import block_folders
from hybridworldsim.training.run.folder import MODEL
from mirror.dataset.dataset import Dataset
from mirror.errors import UsageError
from mirror.schema.scenario import Scenario

PILOT = "pilot"


@dataclass(frozen=True)
class Plan:
    """The plan after the pilot: seeds, methods and the estimated hours.

    Attributes:
        seeds: seeds of each scenario.
        methods: methods whose reconstructions are driven in.
        estimate_h: core-hours that it was estimated to take; None: there is no pilot yet.
    """

    seeds: tuple[int, ...]
    methods: tuple[str, ...]
    estimate_h: float | None = None


@dataclass(frozen=True, eq=False)
class Study:
    """The folder of a study with the data that its stages share.

    Attributes:
        folder: what can be made again: recordings, images, networks, models.
        declaration: what was declared.
        records: finished stages and rollouts.
    """

    folder: Path
    declaration: Declaration
    records: Records

    @cached_property
    def settings(self) -> ControllerSettings:
        """The controller's settings."""
        return ControllerSettings(**self.declaration.controller, sight_m=float(self.declaration.images["sight_m"]))

    @cached_property
    def vehicle(self) -> Vehicle:
        """The vehicle of all rollouts and training images."""
        return vehicle_of(self.declaration.streets, self.declaration.camera)

    def street_folder(self, seed: int) -> Path:
        """Return the folder of a street's recordings and dataset."""
        return self.folder / "streets" / f"street-{seed}"

    def dataset(self, seed: int) -> Dataset:
        """Return the dataset of a street."""
        return mirror.open(self.street_folder(seed) / "dataset")

    def model_folder(self, method: str, seed: int) -> Path:
        """Return the folder of a model."""
        return self.folder / "models" / method / f"street-{seed}"

    def network_file(self, policy: str) -> Path:
        """Return the file of a policy's network."""
        return self.folder / "networks" / f"{policy}.safetensors"

    def place(self, case: Case) -> Place:
        """Return the street of a case, in its light."""
        streets = self.declaration.streets
        seed = int(streets["seeds"][case.street])
        return open_place(self.vehicle, streets["preset"], seed, f"{streets['site']}-{streets[case.light]}")

    def cases(self, seeds: Sequence[int]) -> list[Case]:
        """Return all scenarios with some seeds."""
        return list_cases(self.declaration.scenarios["names"], seeds, len(self.declaration.streets["seeds"]))

    def scenario(self, case: Case, scale: float) -> Scenario:
        """Return the scenario of a case, with its triggers scaled."""
        declared = self.declaration
        return make_scenario(
            case, self.place(case), declared.scenarios, declared.controller["cruise_mps"],
            declared.camera["rate_hz"], scale,
        )  # fmt: skip

    def policy(self, name: str) -> tuple[StudyPolicy, str]:
        """Return a policy, and the hash of its network.

        Raises:
            UsageError: it is not trained.
        """
        camera = self.declaration.camera["name"]
        if name in REFERENCES:
            return REFERENCES[name](self.settings, camera), ""
        if not self.network_file(name).is_file():
            raise UsageError(f"policy {name} is not trained", file=self.network_file(name), remedy="stage perception")
        network, digest = read_network(self.network_file(name))
        return NetworkPolicy(network, self.settings, camera), digest

    def worlds(self, name: str) -> Mapping[int, World]:
        """Return a world, by index of the street."""
        seeds = self.declaration.streets["seeds"]
        if name in self.declaration.worlds:
            return dict.fromkeys(range(len(seeds)), ExactWorld(self.declaration.worlds[name]))
        return {number: self.reconstructed(self.model_folder(name, seed), seed) for number, seed in enumerate(seeds)}

    def reconstructed(self, model: Path, seed: int) -> ReconstructedWorld:
        """Return the world of a model of a street."""
        return ReconstructedWorld(model, self.street_folder(seed) / "dataset", model_hash(model))

    def scale(self, scenario: str) -> float:
        """Return the tuned factor of a scenario's triggers.

        Raises:
            UsageError: they are not tuned.
        """
        figures = self.records.stages.get("triggers")
        if figures is None:
            raise UsageError("the triggers are not tuned", expected="the stage triggers")
        return float(figures["scales"].get(scenario, 1.0))

    def plan(self) -> Plan:
        """Return the plan: everything, or less if the pilot's estimate is over the budget."""
        figures = self.records.stages.get(PILOT)
        if figures is None:
            return Plan(tuple(self.declaration.scenarios["seeds"]), tuple(self.declaration.reconstruction["methods"]))
        return Plan(tuple(figures["seeds"]), tuple(figures["methods"]), float(figures["estimate_h"]))

    def is_current(self, key: RolloutKey) -> bool:
        """Return whether a rollout is recorded with the networks, models and triggers of the last records."""
        row = self.records.rollouts.get(key)
        return row is not None and all(row[name] == value for name, value in self.provenance(key).items())

    def provenance(self, key: RolloutKey) -> Figures:
        """Return the hashes and the scale that a rollout has to have, from the records alone."""
        stages = self.records.stages
        street = next(case.street for case in self.cases([key.seed]) if case.scenario == key.scenario)
        model: str | None = ""
        if key.world in self.declaration.reconstruction["methods"]:
            seed = self.declaration.streets["seeds"][street]
            model = stages.get(f"model-{key.world}-{seed}", {}).get("hash")
        networks: Mapping[str, Any] = stages.get("perception", {}).get("networks", {})
        network = "" if key.policy in REFERENCES else networks.get(key.policy, {}).get("hash")
        scale = tuning_scale(key.world)
        return {"model": model, "network": network, "scale": self.scale(key.scenario) if scale is None else scale}


_TUNING = "exact*"


def tuning_world(scale: float) -> str:
    """Return the name of the exact world in records of the tuning of triggers."""
    return f"{_TUNING}{scale:g}"


def tuning_scale(world: str) -> float | None:
    """Return the scale in the name of a world of the tuning; None: it is another world."""
    return float(world.removeprefix(_TUNING)) if world.startswith(_TUNING) else None


def model_hash(model: Path) -> str:
    """Return the first digits of the SHA-256 of all blocks of a model.

    Raises:
        DatasetError: a block is not finished.
    """
    whole = hashlib.sha256()
    for block in block_folders(model):
        whole.update((block / MODEL).read_bytes())
    return whole.hexdigest()[:12]
