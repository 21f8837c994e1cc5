"""The controls of a rollout as a table, and the policy that repeats them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import pyarrow as pa
import pyarrow.parquet as pq

from hybridworldsim.simulator.ego.vehicle import Controls
from hybridworldsim.simulator.policies.protocol import Action, Observation, ObservationSpec
from mirror.errors import DatasetError, UsageError
from mirror.schema.files import write_bytes

ACTIONS_FILE: Final = "actions.parquet"
_SCHEMA: Final = pa.schema([("acceleration_mps2", pa.float64()), ("curvature_radpm", pa.float64())])


def write_actions(path: Path, actions: Sequence[Controls]) -> None:
    """Write the controls of each step, in order.

    Raises:
        DatasetError: the file cannot be written.
    """
    columns = {name: [getattr(action, name) for action in actions] for name in _SCHEMA.names}
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table(columns, _SCHEMA), sink, compression="zstd")
    write_bytes(path, sink.getvalue().to_pybytes())


def read_actions(path: Path) -> tuple[Controls, ...]:
    """Read the controls of each step.

    Raises:
        DatasetError: the file is missing or broken.
    """
    try:
        table = pq.read_table(path, schema=_SCHEMA)
    except (OSError, pa.ArrowException) as error:
        raise DatasetError(
            "missing or broken", file=path, expected="the controls of a rollout of `mirror simulate`"
        ) from error
    return tuple(Controls(row["acceleration_mps2"], row["curvature_radpm"]) for row in table.to_pylist())


class Repeat:
    """Repeats recorded controls.

    Args:
        actions: the controls of each step.
    """

    cameras: tuple[str, ...] = ()
    privileged = False

    def __init__(self, actions: Sequence[Controls]) -> None:
        self._actions, self._next = tuple(actions), 0

    def reset(self, spec: ObservationSpec) -> None:
        """Begin with the first step."""
        self._next = 0

    def act(self, observation: Observation) -> Action:
        """Return the recorded controls of the step.

        Raises:
            UsageError: the recording has no more steps.
        """
        if self._next >= len(self._actions):
            raise UsageError(f"the recorded rollout has {len(self._actions)} steps", place="--replay")
        self._next += 1
        return self._actions[self._next - 1]

    def close(self) -> None:
        """Release nothing."""
