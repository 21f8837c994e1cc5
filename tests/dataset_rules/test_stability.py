"""No value in a table, and no table without rows, stops the check or makes it warn."""

from __future__ import annotations

import warnings

import numpy as np
import pyarrow as pa
import pytest

from mirror.dataset.check import Cost, check
from tests.dataset_rules.clean import TABLES, Broken
from tests.dataset_rules.edit import A0, BOXES, MASKS

PLACES = {
    "ego_poses": f"traversals/{A0}/recorded",
    "images": f"traversals/{A0}/recorded",
    "calibrations": f"traversals/{A0}/recorded",
    "boxes": BOXES,
    "masks": MASKS,
    "passes": "drives/d0",
}
FLOATS = {"nan": float("nan"), "inf": float("inf"), "huge": -1e308, "tiny": 5e-324, "zero": 0.0}
INTEGERS = {"nan": -1, "inf": 2**31 - 1, "huge": -(2**31), "tiny": 1, "zero": 0}


def run(broken: Broken) -> set[str]:
    with np.errstate(all="ignore"):
        broken.seal()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        report = check(broken.root, cost=Cost.PICTURES)
    return {rule.rule_id for rule, _ in report.findings}


def spoil(broken: Broken, table: str, kind: str) -> None:
    values: dict[str, object] = {}
    for column in TABLES[table].schema:
        if pa.types.is_floating(column.type):
            values[column.name] = FLOATS[kind]
        elif pa.types.is_integer(column.type):
            values[column.name] = INTEGERS[kind]
    broken.set(PLACES[table], table, range(10_000), **values)


@pytest.mark.parametrize("kind", ["nan", "huge"])
@pytest.mark.parametrize("table", PLACES)
def test_any_number_in_one_table(table: str, kind: str, broken: Broken) -> None:
    spoil(broken, table, kind)
    assert run(broken)


@pytest.mark.parametrize("kind", ["inf", "tiny", "zero"])
def test_any_number_in_all_tables(kind: str, broken: Broken) -> None:
    for table in PLACES:
        spoil(broken, table, kind)
    assert run(broken)


@pytest.mark.parametrize("rows", [0, 1])
@pytest.mark.parametrize("table", PLACES)
def test_hardly_a_row(table: str, rows: int, broken: Broken) -> None:
    broken.rows(PLACES[table], table, lambda all_rows: all_rows[:rows])
    run(broken)
