"""State logs as Parquet: read, written whole, and written row group by row group while a rollout runs."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field

from mirror.arrays import AnyArray, Int64
from mirror.errors import SchemaError, UsageError
from mirror.metrics.safety.state_log import StateLog
from mirror.schema.documents import Document
from mirror.schema.files import TableWriter, read_table
from mirror.schema.road_features import SIGNAL_STATES, SignalState
from mirror.schema.rollout_tables import STATES, read_header

EGO: Final = "ego"
"""Id of the ego vehicle in a state log's file."""

_METADATA: Final = b"mirror_state_log"
_STATE: Final = ("x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps")
_SIZE: Final = ("length_m", "width_m")
_REQUIRED: Final = (*_STATE, *_SIZE)
_OPTIONAL: Final = ("z_m", "pitch_rad", "roll_rad", "height_m", "acceleration_mps2", "steering_rad")


class StateLogHeader(Document):
    """The metadata ``mirror_state_log`` of a log's file.

    Attributes:
        rear_axle_to_center_m: distance from the ego's rear axle forward to the centre of its box.
        signals: ids of the signals, in the order of the column ``signals``.
    """

    rear_axle_to_center_m: float = Field(allow_inf_nan=False)
    signals: tuple[str, ...] = ()


class StateLogWriter:
    """A writer of a state log, instant by instant, in row groups.

    The file has a temporary name until the writer is closed. As a context manager it is closed whatever happens, so
    that the log of an interrupted rollout is complete up to there. Only a process that is killed leaves no log.

    Args:
        path: the final path of the file, such as ``RUN/states.parquet``.
        rear_axle_to_center_m: distance from the ego's rear axle forward to the centre of its box.
        signals: ids of the map's signals whose states are logged.
        group_stamps: number of instants in a row group.

    Raises:
        DatasetError: the file cannot be written.

    Example:
        >>> with StateLogWriter(run / "states.parquet", rear_axle_to_center_m=1.4) as log:
        ...     log.append(stamp_ns, ids, categories, {"x_m": x, "y_m": y, ...})
    """

    def __init__(
        self, path: str | Path, *, rear_axle_to_center_m: float, signals: Sequence[str] = (), group_stamps: int = 10
    ) -> None:
        if group_stamps < 1:
            raise UsageError(f"group_stamps is {group_stamps}", expected="at least 1")
        header = StateLogHeader(rear_axle_to_center_m=rear_axle_to_center_m, signals=tuple(signals))
        self.path = Path(path)
        self._signals = tuple(signals)
        self._group_stamps = group_stamps
        self._writer = TableWriter(self.path, STATES, {_METADATA: header.model_dump_json().encode()})
        self._pending: list[pa.Table] = []
        self._last_ns: int | None = None
        self._closed = False

    def append(
        self,
        stamp_ns: int,
        ids: Sequence[str],
        categories: Sequence[str],
        columns: Mapping[str, npt.ArrayLike],
        signals: Sequence[SignalState] = (),
    ) -> None:
        """Append the states of M actors at one instant; absent actors are left out.

        Args:
            stamp_ns: the instant; later than the last one.
            ids: M distinct ids; the first one is ``ego``.
            categories: M categories.
            columns: by name of a column of the table ``states`` (docs/schema.md), (M,) values; the columns that the
                table allows to be null may be missing, or NaN where unknown.
            signals: states of the signals, in the order that the writer was made with.

        Raises:
            UsageError: the stamp is not later, the ego is not the first actor, an id repeats, a column is missing or
                has another length, or a value is not finite; actor and column are named.
            DatasetError: the disk is full.
        """
        if self._closed:
            raise UsageError("the log is closed", file=self.path)
        if self._last_ns is not None and stamp_ns <= self._last_ns:
            raise UsageError(f"stamp {stamp_ns} does not come after {self._last_ns}", file=self.path)
        if not ids or ids[0] != EGO or len(set(ids)) != len(ids) or len(categories) != len(ids):
            raise UsageError(
                f"actors {', '.join(ids[:3])} with {len(categories)} categories",
                file=self.path,
                place=f"stamp {stamp_ns}",
                expected=f"distinct ids, {EGO!r} first, and one category each",
            )
        if len(signals) != len(self._signals) or any(state not in SIGNAL_STATES for state in signals):
            raise UsageError(
                f"signals {list(signals)}",
                file=self.path,
                place=f"stamp {stamp_ns}",
                expected=f"a state of each of {list(self._signals)}: one of {', '.join(SIGNAL_STATES)}",
            )
        unknown = set(columns) - set(_REQUIRED) - set(_OPTIONAL)
        if unknown:
            raise UsageError(f"unknown column {min(unknown)!r}", expected=f"one of {', '.join(_REQUIRED + _OPTIONAL)}")
        values = {name: self._column(name, columns, stamp_ns, ids) for name in (*_REQUIRED, *_OPTIONAL)}
        nothing: list[list[str] | None] = [None] * (len(ids) - 1)
        rows = {
            "timestamp_ns": pa.array(np.full(len(ids), stamp_ns, np.int64)),
            "actor_id": pa.array(list(ids), pa.string()),
            "category": pa.array(list(categories), pa.string()),
            **values,
            "signals": pa.array([list(signals), *nothing], pa.list_(pa.string())),
        }
        self._pending.append(pa.table(rows))
        self._last_ns = stamp_ns
        if len(self._pending) == self._group_stamps:
            self._flush()

    def _column(self, name: str, columns: Mapping[str, npt.ArrayLike], stamp_ns: int, ids: Sequence[str]) -> pa.Array:
        if name not in columns and name in _OPTIONAL:
            return pa.nulls(len(ids), pa.float64())
        given = np.asarray(columns.get(name, ()), np.float64)
        place = f"stamp {stamp_ns}, column {name}"
        if given.shape != (len(ids),):
            raise UsageError(
                f"values of shape {given.shape}", file=self.path, place=place, expected=f"({len(ids)},): one an actor"
            )
        wrong = np.isinf(given) if name in _OPTIONAL else ~np.isfinite(given)
        if name in _SIZE:
            wrong |= ~(given > 0.0)
        if wrong.any():
            actor = int(np.argmax(wrong))
            raise UsageError(
                f"{name} is {given[actor]}",
                file=self.path,
                place=f"stamp {stamp_ns}, actor {ids[actor]!r}",
                expected="a positive number" if name in _SIZE else "a finite number",
            )
        return pa.array(given, from_pandas=name in _OPTIONAL)

    def _flush(self) -> None:
        if self._pending:
            self._writer.write(pa.concat_tables(self._pending).combine_chunks())
            self._pending = []

    def close(self) -> None:
        """Complete the file and give it its name. A log without any instant leaves no file.

        Raises:
            DatasetError: the disk is full.
        """
        if self._closed:
            return
        self._closed = True
        if self._last_ns is None:
            self._writer.abandon()
            return
        self._flush()
        self._writer.finish().replace(self.path)

    def __enter__(self) -> StateLogWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def write_state_log(path: str | Path, log: StateLog) -> None:
    """Write a state log as Parquet, atomically. The ego's id in the file is ``ego``.

    Raises:
        DatasetError: the file cannot be written.
    """
    ids = (EGO, *log.ids[1:])
    signals: Sequence[Sequence[SignalState]] = [
        [SIGNAL_STATES[state] for state in states] for states in log.shown_signals
    ]
    with StateLogWriter(path, rear_axle_to_center_m=log.rear_axle_to_center_m, signals=log.signals) as writer:
        for row, stamp in enumerate(log.stamps_ns.tolist()):
            here = np.flatnonzero(log.present[row])
            columns = {name: getattr(log, name)[row, here] for name in _STATE}
            columns |= {name: getattr(log, name)[here] for name in _SIZE}
            names, categories = ([labels[actor] for actor in here] for labels in (ids, log.categories))
            writer.append(stamp, names, categories, columns, signals[row])


def read_state_log(path: str | Path) -> StateLog:
    """Read a state log.

    Actors are in the order of their first appearance. Columns that a `StateLog` does not have, such as heights, are
    read with `mirror.schema.files.read_table` and the table ``STATES``.

    Raises:
        DatasetError: the file is missing.
        SchemaError: the file is not a state log, or an actor changes its category or size, appears twice at an instant,
            or has a state that is not finite; or the ego is absent at an instant.
    """
    path = Path(path)
    table = read_table(path, STATES, ["timestamp_ns", "actor_id", "category", *_REQUIRED, "signals"])
    header = read_header(path, _METADATA, StateLogHeader)
    stamps, row = np.unique(table["timestamp_ns"].to_numpy(), return_inverse=True)
    names = pc.unique(table["actor_id"]).to_pylist()
    if EGO not in names:
        raise SchemaError(
            f"no actor {EGO!r}",
            file=path,
            place="column actor_id",
            expected="states of the ego too",
            remedy="drive the scenario again with `mirror simulate`",
        )
    names = [EGO, *(name for name in names if name != EGO)]
    actor = pc.index_in(table["actor_id"], pa.array(names, pa.string())).to_numpy().astype(np.int64)
    present = np.zeros((len(stamps), len(names)), np.bool_)
    present[row, actor] = True
    if present.sum() != len(row):
        raise SchemaError(
            "an actor has two states at one instant",
            file=path,
            place="columns timestamp_ns, actor_id",
            expected="one state each",
            remedy="drive the scenario again with `mirror simulate`",
        )
    first = np.full(len(names), -1)
    first[actor[::-1]] = np.arange(len(actor))[::-1]
    sizes = {name: _constant(table[name].to_numpy(), name, actor, first, names, path) for name in _SIZE}
    category = pc.cast(table["category"], pa.string()).to_numpy(zero_copy_only=False)
    try:
        return StateLog(
            stamps_ns=stamps,
            **{name: _spread(table[name].to_numpy(), row, actor, present.shape) for name in _STATE},
            **sizes,
            present=present,
            ids=tuple(names),
            categories=tuple(_constant(category, "category", actor, first, names, path).tolist()),
            rear_axle_to_center_m=header.rear_axle_to_center_m,
            signals=header.signals,
            signal_states=_signal_states(table, actor, row, len(stamps), header.signals, path),
        )
    except UsageError as error:
        raise SchemaError(error.problem, file=path, place=error.place, expected=error.expected) from error


def _spread(values: AnyArray, row: Int64, actor: Int64, shape: tuple[int, ...]) -> AnyArray:
    spread = np.full(shape, np.nan)
    spread[row, actor] = values
    return spread


def _constant(values: AnyArray, name: str, actor: Int64, first: Int64, names: Sequence[str], path: Path) -> AnyArray:
    """The values (N,) of the actors; they must not change."""
    constant = values[first]
    changed = np.flatnonzero(values != constant[actor])
    if len(changed):
        raise SchemaError(
            f"{name} changes from {constant[actor[changed[0]]]} to {values[changed[0]]}",
            file=path,
            place=f"actor {names[actor[changed[0]]]!r}",
            expected="the same at all instants",
        )
    return constant


def _signal_states(
    table: pa.Table, actor: Int64, row: Int64, stamps: int, signals: Sequence[str], path: Path
) -> npt.NDArray[np.int8]:
    states = np.zeros((stamps, len(signals)), np.int8)
    number: Mapping[Any, int] = {state: index for index, state in enumerate(SIGNAL_STATES)}
    rows = np.flatnonzero(actor == 0)
    for at, shown in zip(row[rows].tolist(), table["signals"].take(pa.array(rows)).to_pylist()):
        if len(shown or ()) != len(signals) or any(state not in number for state in shown or ()):
            raise SchemaError(
                f"signals {json.dumps(shown)}", file=path, place=f"instant {at}", expected=f"states of {list(signals)}"
            )
        states[at] = [number[state] for state in shown or ()]
    return states
