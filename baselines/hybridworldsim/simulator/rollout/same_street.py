"""Whether a rollout can be repeated: its controls lead to the same states only on the street that it was driven on."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from hybridworldsim.simulator.simulation import start_simulation
from hybridworldsim.simulator.street.street import Street
from mirror.errors import UsageError
from mirror.metrics.safety import read_state_log
from mirror.schema.road_map import encode_road_map, read_road_map
from mirror.schema.rollout import MAP_FILE, ROLLOUT, SCENARIO_FILE, STATES_FILE, Rollout
from mirror.schema.scenario import Scenario


def require_same_street(
    folder: Path, earlier: Rollout, street: Street, scenario: Scenario, dataset_hash: str | None,
    option: str = "--replay",
) -> None:  # fmt: skip
    """Require that a rollout was driven on a street: in its scene, dataset, map and recording.

    The renderer and its model may be others: the states do not depend on them.

    Args:
        folder: folder of the rollout.
        earlier: its document.
        street: the street.
        scenario: the scenario of the rollout.
        dataset_hash: hash of the dataset of the street; None: it is synthetic.
        option: the option that names the rollout.

    Raises:
        UsageError: the rollout was driven on another street; the error says which.
        DatasetError, SchemaError: the map or the states of the rollout cannot be read.
    """
    if earlier.scene_id != street.scene_id:
        raise _another_street(folder, ROLLOUT, f"scene {earlier.scene_id!r}", f"scene {street.scene_id!r}", option)
    if earlier.dataset_hash != dataset_hash:
        raise _another_street(folder, ROLLOUT, _dataset(earlier.dataset_hash), _dataset(dataset_hash), option)
    driven, present = (encode_road_map(one) for one in (read_road_map(folder / MAP_FILE), street.road_map))
    if driven != present:
        raise _another_street(
            folder, MAP_FILE, f"the road map of this file ({earlier.map_source or 'source not stated'})",
            f"another one of scene {street.scene_id!r} ({street.map_source or 'source not stated'})", option,
        )  # fmt: skip
    simulation = start_simulation(street, scenario, earlier.seed, scenario_file=str(folder / SCENARIO_FILE))
    start_ns = int(read_state_log(folder / STATES_FILE).stamps_ns[0])
    if start_ns != simulation.now.stamp_ns:
        raise _another_street(
            folder, STATES_FILE, f"a recording in which the scenario begins at {_utc(start_ns)}",
            f"one in which it begins at {_utc(simulation.now.stamp_ns)}", option,
        )  # fmt: skip


def _another_street(folder: Path, file: str, made: str, given: str, option: str) -> UsageError:
    return UsageError(
        f"the rollout was made with {made}; this street has {given}", file=folder / file, place=option,
        expected="the street of the rollout", remedy="name the street, dataset and map that the rollout was made with",
    )  # fmt: skip


def _dataset(dataset_hash: str | None) -> str:
    return "a synthetic street" if dataset_hash is None else f"the dataset {dataset_hash}"


def _utc(stamp_ns: int) -> str:
    return datetime.fromtimestamp(stamp_ns * 1e-9, UTC).isoformat(timespec="milliseconds")
