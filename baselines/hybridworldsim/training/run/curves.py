"""The curves of a run: a table with one row for each report."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeAlias

from mirror.schema.files import write_bytes

Row: TypeAlias = Mapping[str, float]
"""``step progress core_s wall_s``, further figures of what is trained, and the losses by name."""


def write_curves(path: Path, rows: Sequence[Row]) -> None:
    """Write all rows of the learning curves, replacing the file."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    sink = io.StringIO()
    writer = csv.DictWriter(sink, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows({name: f"{value:.9g}" for name, value in row.items()} for row in rows)
    write_bytes(path, sink.getvalue().encode())


def read_curves(path: Path, max_rows: int) -> list[Row]:
    """Read the first rows of the learning curves; empty if no file exists yet."""
    if not path.exists():
        return []
    with path.open(newline="") as file:
        rows = [{name: float(value) for name, value in row.items() if value} for row in csv.DictReader(file)]
    return list(rows[:max_rows])
