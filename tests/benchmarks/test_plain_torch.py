"""The benchmark of the torch forms at a tiny size; what it compares is tested beside each form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.gpu.machine import Machine
from benchmarks.plain_torch import benchmark
from benchmarks.plain_torch.scene import PreparedBlock, Variant, points_apart, train_street
from benchmarks.plain_torch.sizes import PARTS
from mirror.errors import UsageError
from tests.training.street import Painted, initial, views

TINY = Machine("cpu", 2e-4)


@pytest.mark.parametrize("part", ["street", "rows", "fusion", "composition", "covers"])
def test_a_part_computes_and_agrees_with_the_compiled_form(part: str) -> None:
    line = PARTS[part](TINY)
    assert line.seconds > 0.0 and line.memory_gb > 0.0
    words = line.agreement.split()
    numbers = [float(word) for word in words if word[0].isdigit()]
    assert len(numbers) == 1 and numbers[0] <= 1e-3, line.agreement
    assert str(line).count("|") == 5


def test_a_street_is_trained_by_either_form_over_its_own_images() -> None:
    images = Painted()
    block = PreparedBlock(initial(), tuple(views()), images)
    untrained, kernels = train_street(block, Variant(), 0, 0), train_street(block, Variant(), 12, 0)
    assert kernels > untrained + 1.0
    assert train_street(block, Variant("torch"), 12, 0) == pytest.approx(kernels, abs=0.01)
    assert train_street(block, Variant(), 12, 1) != pytest.approx(kernels, abs=1e-6)
    assert images.opened >= 4 * len(views()) + 3 * 12


def test_points_are_compared_number_by_number() -> None:
    first = initial()
    moved = replace(first, points_m=first.points_m + np.array([0.0, 0.25, 0.0]))
    assert points_apart(first, moved) == "200 and 200 points, 2.5e-01 m apart at most"
    assert points_apart(first, replace(first, points_m=first.points_m[:150])) == "200 and 150 points"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--only", "speed"], "--only: 'speed'; expected sizes, adam, verb"),
        (["--part", "speed"], "--part: 'speed'; expected street, rows"),
        (["--scale", "2"], "--scale: 2; expected more than 0"),
        (["--width", "8"], "--width: 8; expected 16 or more"),
        (["--seeds", "0"], "--seeds: 0; expected 1 or more"),
    ],
)
def test_wrong_options_are_refused(words: list[str], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        benchmark.main(words)
