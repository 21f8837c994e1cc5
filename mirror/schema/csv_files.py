"""Tables as CSV that spreadsheets open: a text that they would take for a formula is quoted."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from decimal import Decimal
from typing import Final

_FORMULA: Final = ("=", "+", "-", "@", "\t", "\r", "\n", "＝", "＋", "－", "＠")
"""First characters with which spreadsheets take a cell for a formula."""

Cell = str | int | float | Decimal | bool | None


def encode_csv(header: Sequence[str], rows: Iterable[Sequence[Cell]]) -> bytes:
    """Encode a table as CSV with a header, in UTF-8; None is empty.

    Texts, those of the header included, may be of strangers: one that a spreadsheet would run as a formula begins with
    an apostrophe, which spreadsheets do not show. Numbers stay as they are.

    Args:
        header: names of the columns.
        rows: the rows.

    Example:
        >>> encode_csv(["name", "score"], [["=1+1", -2.5]]).splitlines()
        [b'name,score', b"'=1+1,-2.5"]
    """
    sink = io.StringIO()
    writer = csv.writer(sink, lineterminator="\n")
    writer.writerow(map(_quote_formula, header))
    for row in rows:
        writer.writerow(map(_quote_formula, row))
    return sink.getvalue().encode()


def _quote_formula(cell: Cell) -> Cell:
    return f"'{cell}" if isinstance(cell, str) and cell.startswith(_FORMULA) else cell
