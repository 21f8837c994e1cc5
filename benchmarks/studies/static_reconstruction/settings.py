"""Settings of rows as Markdown tables; rows with mostly the same settings share a table."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from benchmarks.studies.static_reconstruction.methods import entries

_OF_EACH = ("seed", "method", "split")


def settings_tables(rows: Sequence[str]) -> Iterator[str]:
    """Yield tables with a column for each row of the comparison; learning rates show their first and last values."""
    tables: list[dict[str, Mapping[str, str]]] = []
    for row in rows:
        own = dict(_flat(entries()[row].settings(0)))
        alike = (table for table in tables if 2 * len(own.keys() & next(iter(table.values())).keys()) > len(own))
        table = next(alike, {})
        if not table:
            tables.append(table)
        table[row] = own
    for columns in tables:
        names = dict.fromkeys(name for own in columns.values() for name in own)
        lines = [f"| setting | {' | '.join(columns)} |", "|---" * (len(columns) + 1) + "|"]
        lines += [f"| {name} | {' | '.join(own.get(name, '-') for own in columns.values())} |" for name in names]
        yield "\n".join(lines)


def _flat(settings: Mapping[str, Any], under: str = "") -> Iterator[tuple[str, str]]:
    for name, value in settings.items():
        if name in _OF_EACH:
            continue
        if isinstance(value, dict) and set(value) == {"first", "last"}:
            yield f"{under}{name}", f"{value['first']:g} to {value['last']:g}"
        elif isinstance(value, dict):
            yield from _flat(value, f"{under}{name}.")
        else:
            yield f"{under}{name}", f"{value:g}" if isinstance(value, float) else "-" if value is None else str(value)
