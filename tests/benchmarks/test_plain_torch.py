"""The benchmark of the torch forms at a tiny size; what it compares is tested beside each form."""

from __future__ import annotations

import pytest

from benchmarks.gpu.machine import Machine
from benchmarks.plain_torch import benchmark
from benchmarks.plain_torch.sizes import PARTS
from mirror.errors import UsageError

TINY = Machine("cpu", 2e-4)


@pytest.mark.parametrize("part", ["street", "rows", "fusion", "composition", "covers"])
def test_a_part_computes_and_agrees_with_the_compiled_form(part: str) -> None:
    line = PARTS[part](TINY)
    assert line.seconds > 0.0 and line.memory_gb > 0.0
    words = line.agreement.split()
    numbers = [float(word) for word in words if word[0].isdigit()]
    assert len(numbers) == 1 and numbers[0] <= 1e-3, line.agreement
    assert str(line).count("|") == 5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--only", "speed"], "--only: 'speed'; expected sizes, adam, verb"),
        (["--part", "speed"], "--part: 'speed'; expected street, rows"),
        (["--scale", "2"], "--scale: 2; expected more than 0"),
    ],
)
def test_wrong_options_are_refused(words: list[str], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        benchmark.main(words)
