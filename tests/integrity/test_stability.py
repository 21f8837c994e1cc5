"""No value in a table, and no table without rows, stops the check or makes it warn."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import numpy as np
import pyarrow as pa
import pytest

from mirror.integrity import Cost, check
from mirror.integrity.finding import Finding, Severity
from mirror.integrity.registry import rules
from mirror.integrity.rule import Rule
from tests.integrity.clean import TABLES, Broken
from tests.integrity.edit import A0, BOXES, MASKS

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


def run(broken: Broken) -> list[tuple[Rule, Finding]]:
    with np.errstate(all="ignore"):
        broken.seal()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        report = check(broken.root, cost=Cost.IMAGES)
    # The check goes on after a rule that fails, but none of ours may fail.
    assert not [finding for _, finding in report.findings if "cannot be evaluated" in finding.message]
    return list(report.findings)


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


@pytest.mark.parametrize("model", ["brown_conrady", "rational", "kannala_brandt", "f_theta"])
def test_a_distortion_beyond_any_lens(model: str, broken: Broken) -> None:
    """The check died of a LinAlgError, and printed no finding."""
    count = {"brown_conrady": 5, "rational": 8, "kannala_brandt": 4, "f_theta": 4}[model]
    for row, coefficient in enumerate((1e308, -1e308, 1e150)):
        distortion = [0.0, 500.0, *[coefficient] * (count - 2)]
        broken.set(A0, "calibrations", row, model=model, distortion=distortion)
    assert [finding.count for rule, finding in run(broken) if rule.rule_id == "CAM003"] == [3]


def test_a_rule_that_fails_is_a_finding_and_the_others_go_on(broken: Broken, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(view: object) -> Iterator[Finding]:
        """A rule."""
        yield Finding("a", None, "found before it fails")
        raise np.linalg.LinAlgError("Array must not contain infs or NaNs")

    broken.set(A0, "ego_poses", 3, qw=7.0)
    broken.seal()
    for rule in (
        Rule("ZZZ001", Severity.INFO, Cost.TABLES, "A rule.", "none", of_dataset=fails),
        Rule("ZZZ002", Severity.WARNING, Cost.TABLES, "A rule.", "none", of_scene=fails),
    ):
        monkeypatch.setitem(rules(), rule.rule_id, rule)
    report = check(broken.root, only=("ZZZ", "POS"))
    found = [(rule.rule_id, rule.severity, finding.file, finding.place) for rule, finding in report.findings]
    assert ("ZZZ001", Severity.ERROR, "dataset.json", None) in found
    assert ("ZZZ002", Severity.ERROR, "rois.geojson", "scene a") in found
    assert ("ZZZ001", Severity.INFO, "a", None) in found
    assert any(rule_id.startswith("POS") for rule_id, *_ in found)
    messages = [finding.message for _, finding in report.findings]
    assert any("(LinAlgError: Array must not contain infs or NaNs)" in message for message in messages)
    assert report.exit_code() == 1
