"""The controls of a rollout as a table, and the policy that repeats them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
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


def read_actions(path: Path, most: int | None = None) -> tuple[Controls, ...]:
    """Read the controls of each step.

    Args:
        path: the file.
        most: greatest number of steps that is accepted; None: any.

    Raises:
        DatasetError: the file is missing or broken, has more steps, or a value is missing or not finite.
    """
    expected = "the controls of a rollout of `mirror simulate`"
    try:
        with pq.ParquetFile(path) as file:
            steps = file.metadata.num_rows
            if most is not None and steps > most:
                raise DatasetError(f"{steps} steps", file=path, expected=f"at most {most}")
        table = pq.read_table(path, schema=_SCHEMA)
    except (OSError, pa.ArrowException) as error:
        raise DatasetError("missing or broken", file=path, expected=expected) from error
    columns = [table[name].to_numpy() for name in _SCHEMA.names]
    wrong = np.flatnonzero(~np.isfinite(columns).all(axis=0))
    if len(wrong):
        raise DatasetError("no finite number", file=path, place=f"step {wrong[0]}", expected=expected)
    return tuple(Controls(*row) for row in zip(*(column.tolist() for column in columns), strict=True))


class Repeat:
    """A policy that repeats recorded controls.

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
            raise UsageError(
                f"the recorded rollout has {len(self._actions)} steps",
                place="--replay",
                remedy="leave --duration out, or drive the scenario again",
            )
        self._next += 1
        return self._actions[self._next - 1]

    def close(self) -> None:
        """Release nothing."""
