"""State logs as Parquet: equal to the bit, complete after an interruption, and strict about what they hold."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from mirror.errors import DatasetError, SchemaError, UsageError
from mirror.metrics.safety import StateLog, StateLogWriter, read_state_log, write_state_log
from tests.metrics.safety.logs import random_log


def with_signals(log: StateLog) -> StateLog:
    shown = np.random.default_rng(0).integers(0, 4, (len(log.stamps_ns), 2)).astype(np.int8)
    return replace(log, signals=("north", "south"), signal_states=shown)


def require_equal(one: StateLog, other: StateLog) -> None:
    assert (one.ids, one.categories, one.signals) == (other.ids, other.categories, other.signals)
    assert one.rear_axle_to_center_m == other.rear_axle_to_center_m
    for name in ("stamps_ns", "length_m", "width_m", "present", "shown_signals"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    for name in ("x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps"):
        np.testing.assert_array_equal(getattr(one, name)[one.present], getattr(other, name)[other.present])


@pytest.mark.parametrize("seed", range(3))
def test_a_written_log_reads_back_to_the_bit(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)
    log = with_signals(random_log(rng, agents=5, stamps=33))
    present = rng.random(log.present.shape) < 0.7
    present[:, 0] = present[0] = True
    log = replace(log, present=present)
    write_state_log(tmp_path / "states.parquet", log)
    require_equal(read_state_log(tmp_path / "states.parquet"), log)
    assert pq.ParquetFile(tmp_path / "states.parquet").num_row_groups == 4
    assert [path.name for path in tmp_path.iterdir()] == ["states.parquet"]


def append(writer: StateLogWriter, stamp: int, count: int = 2, **more: object) -> None:
    columns = {name: np.ones(count) for name in ("x_m", "y_m", "yaw_rad", "vx_mps", "vy_mps", "length_m", "width_m")}
    columns |= {name: value for name, value in more.items() if name.endswith(("_m", "_mps", "_rad"))}
    ids = more.get("ids", ["ego", *(f"agent{number}" for number in range(1, count))])
    writer.append(stamp, ids, ["car"] * count, columns, more.get("signals", ()))


def test_the_log_of_an_interrupted_rollout_is_complete_up_to_there(tmp_path: Path) -> None:
    path = tmp_path / "states.parquet"
    with pytest.raises(KeyboardInterrupt), StateLogWriter(path, rear_axle_to_center_m=1.4) as writer:
        for stamp in range(100):
            if stamp == 57:
                assert not path.exists()
                raise KeyboardInterrupt
            append(writer, stamp, z_m=np.array([0.5, np.nan]))
    assert read_state_log(path).stamps_ns.tolist() == list(range(57))
    heights = pq.read_table(path, columns=["z_m"])["z_m"].to_pylist()[:2]
    assert heights == [0.5, None]


def test_a_log_without_an_instant_leaves_no_file(tmp_path: Path) -> None:
    with StateLogWriter(tmp_path / "run" / "states.parquet", rear_axle_to_center_m=1.4):
        pass
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"x_m": np.array([1.0, np.nan])}, "x_m is nan"),
        ({"z_m": np.array([1.0, np.inf])}, "z_m is inf"),
        ({"width_m": np.array([1.0, 0.0])}, "width_m is 0"),
        ({"x_m": np.ones(3)}, "values of shape"),
        ({"ids": ["agent1", "ego"]}, "distinct ids"),
        ({"ids": ["ego", "ego"]}, "distinct ids"),
        ({"signals": ["green"]}, "signals"),
        ({"depth_m": np.ones(2)}, "unknown column"),
    ],
)
def test_bad_states_are_refused_and_the_log_before_them_kept(
    more: dict[str, object], message: str, tmp_path: Path
) -> None:
    path = tmp_path / "states.parquet"
    with pytest.raises(UsageError, match=message), StateLogWriter(path, rear_axle_to_center_m=1.4) as writer:
        append(writer, 5)
        append(writer, 6, **more)
    assert read_state_log(path).stamps_ns.tolist() == [5]


def test_stamps_increase_and_a_closed_log_is_closed(tmp_path: Path) -> None:
    with StateLogWriter(tmp_path / "states.parquet", rear_axle_to_center_m=1.4) as writer:
        append(writer, 5)
        with pytest.raises(UsageError, match="does not come after"):
            append(writer, 5)
    with pytest.raises(UsageError, match="closed"):
        append(writer, 6)


def test_bad_files_are_refused(tmp_path: Path) -> None:
    path, bad = tmp_path / "states.parquet", tmp_path / "bad.parquet"
    with pytest.raises(DatasetError, match="missing"):
        read_state_log(path)
    write_state_log(path, with_signals(random_log(np.random.default_rng(0), agents=2, stamps=3)))
    data = pq.read_table(path)

    def written(rows: list[dict[str, object]]) -> Path:
        pq.write_table(pa.Table.from_pylist(rows, schema=data.schema), bad)
        return bad

    pq.write_table(data.replace_schema_metadata(None), bad)
    with pytest.raises(SchemaError, match="mirror_state_log"):
        read_state_log(bad)
    for change, message in (
        ({"length_m": 9.0}, "length_m changes"),
        ({"category": "bus"}, "category changes"),
        ({"x_m": float("nan")}, "x_m is nan"),
    ):
        rows = data.to_pylist()
        rows[-1].update(change)
        with pytest.raises(SchemaError, match=message):
            read_state_log(written(rows))
    rows = data.to_pylist()
    with pytest.raises(SchemaError, match="two states"):
        read_state_log(written([*rows, rows[-1]]))
    with pytest.raises(SchemaError, match="the ego"):
        read_state_log(written(rows[:-3] + rows[-2:]))
    with pytest.raises(SchemaError, match="no actor 'ego'"):
        read_state_log(written([row for row in rows if row["actor_id"] != "ego"]))
    rows[0]["signals"] = ["green", "blue"]
    with pytest.raises(SchemaError, match="blue"):
        read_state_log(written(rows))
