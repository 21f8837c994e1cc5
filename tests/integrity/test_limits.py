"""What lies exactly at the limit of a rule is no finding, and what lies just beyond it is one."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from mirror.integrity import Cost, check
from mirror.integrity.rules.ledger import counted_path
from mirror.integrity.summary import summarise
from tests.integrity.clean import Broken
from tests.integrity.edit import A0


def finds(broken: Broken, rule: str) -> bool:
    broken.seal()
    return {found.rule_id for found, _ in check(broken.root, only=[rule], cost=Cost.IMAGES).findings} == {rule}


@pytest.mark.parametrize(("column", "extreme", "outward"), [("entry_ns", min, 1), ("exit_ns", max, -1)])
def test_an_image_at_the_entry_or_exit_is_of_the_pass(
    broken: Broken, column: str, extreme: Callable[[Iterable[int]], int], outward: int
) -> None:
    stamp = extreme(row["timestamp_ns"] for row in broken.read(A0, "images"))
    accepted = [row["traversal_id"] for row in broken.read("d0", "passes")].index(A0)
    broken.set("d0", "passes", accepted, **{column: stamp})
    assert not finds(broken, "TIM009")
    broken.set("d0", "passes", accepted, **{column: stamp + outward})
    assert finds(broken, "TIM009")


def test_points_nearer_than_the_least_step_do_not_count() -> None:
    x, y = np.array([0.0, 1.0, 1.1, 1.0, 5.0, 5.0]), np.array([0.0, 0.0, 0.3, 1.0, 1.0, 4.0])
    assert counted_path(x, y, np.full(6, 0.5)) == pytest.approx(1.0 + 1.0 + 4.0 + 3.0)


def test_the_summary_spans_all_passes(clean: Path) -> None:
    passes = pd.concat([pd.read_parquet(file) for file in sorted(clean.glob("drives/*/passes.parquet"))])
    accepted = passes[passes["decision"] == "accepted"]
    assert accepted["exit_ns"].nunique() > 1
    summary = summarise(clean)
    assert (summary.first_ns, summary.last_ns) == (accepted["entry_ns"].min(), accepted["exit_ns"].max())


@pytest.mark.parametrize(
    ("column", "limit", "is_beyond"), [("duration_s", 10.0, False), ("path_m", 20.0, False), ("overlap", 0.9, True)]
)
def test_a_pass_at_a_threshold_of_the_trigger(broken: Broken, column: str, limit: float, is_beyond: bool) -> None:
    """At least 10 s and 20 m, and more than 90 %."""
    accepted = [row["traversal_id"] for row in broken.read("d0", "passes")].index(A0)
    broken.set("d0", "passes", accepted, **{column: limit})
    assert finds(broken, "LED001") == is_beyond
    broken.set("d0", "passes", accepted, **{column: np.nextafter(limit, 0.0)})
    assert finds(broken, "LED001")
    broken.set("d0", "passes", accepted, **{column: np.nextafter(limit, np.inf)})
    assert not finds(broken, "LED001")
