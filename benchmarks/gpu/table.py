"""The table of docs/performance.md: every quantity on every device that was measured; others are "not measured"."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from benchmarks.gpu.quantities import Measurement, list_quantities
from mirror.errors import DatasetError
from mirror.schema.files import read_json, write_bytes

ROOT: Final = Path(__file__).resolve().parents[2]
FOLDER: Final = ROOT / "docs" / "gpu"
PAGE: Final = ROOT / "docs" / "performance.md"
_BEGIN: Final = "<!-- gpu: `python -m benchmarks gpu --table` writes from here -->\n"
_END: Final = "<!-- gpu: to here -->\n"
ABSENT: Final = "not measured"


def read_measurements(folder: Path = FOLDER) -> list[Measurement]:
    """Read the measurements of all devices, in the order of their files."""
    return [read_json(path, Measurement) for path in sorted(folder.glob("*.json"))]


def make_table(measurements: Sequence[Measurement]) -> str:
    """Return the table in Markdown; without a measurement it has one column, in which nothing is measured."""
    heads = [one.device for one in measurements] or ["no GPU yet"]
    lines = [f"| what | unit | {' | '.join(heads)} | beside |", f"|---|---|{'---|' * len(heads)}---|"]
    for quantity in list_quantities():
        cells = [_cell(one, quantity.part, quantity.name) for one in measurements] or [ABSENT]
        lines.append(f"| {quantity.key} | {quantity.unit} | {' | '.join(cells)} | {quantity.beside} |")
    return "\n".join(lines) + "\n"


def _cell(measurement: Measurement, part: str, name: str) -> str:
    result = measurement.parts.get(part)
    value = None if result is None else result.values.get(name)
    return ABSENT if value is None else f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"


def write_table(page: Path = PAGE, folder: Path = FOLDER) -> None:
    """Write the table into a page, between its two marks.

    Raises:
        DatasetError: the page lacks a mark.
    """
    text = page.read_text()
    before, begin, rest = text.partition(_BEGIN)
    _, end, after = rest.partition(_END)
    if not (begin and end):
        raise DatasetError(
            "no place for the table", file=page, expected=f"lines {_BEGIN.strip()!r} and {_END.strip()!r}",
            remedy="restore them",
        )  # fmt: skip
    write_bytes(page, f"{before}{begin}{make_table(read_measurements(folder))}{end}{after}".encode())
