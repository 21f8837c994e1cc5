"""What lies exactly at the limit of a rule is no finding, and what lies just beyond it is one."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import pytest

from mirror.integrity import Cost, check
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
