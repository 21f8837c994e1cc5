"""Figures of small logs are computed as plain Python where their machine code is not cached, with the same bits."""

from __future__ import annotations

import numpy as np
import pytest

from mirror.metrics.safety import (
    collision_kernels,
    comfort_kernels,
    drivable_area_kernels,
    lane_kernels,
    preset_kernels,
    rectangle_kernels,
    score_rollout,
    time_to_collision,
    ttc_kernels,
)
from tests.metrics.safety.logs import random_log
from tests.metrics.safety.streets import moved_map, two_way_street, with_signal
from tests.plain_forms import compare_forms

_KERNELS = (
    collision_kernels, comfort_kernels, drivable_area_kernels, lane_kernels, preset_kernels, rectangle_kernels,
    ttc_kernels,
)  # fmt: skip


def test_both_forms_of_the_figures_give_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = compare_forms(monkeypatch, *_KERNELS, own=True)
    route = np.stack([np.linspace(-40.0, 120.0, 161), np.zeros(161)], axis=1)
    for seed in range(25):
        rng = np.random.default_rng(seed)
        log = random_log(rng, agents=1 + seed % 5, stamps=12 + seed)
        log = with_signal(log, rng.integers(0, 3, len(log.stamps_ns)).tolist())
        street = two_way_street() if seed % 2 else moved_map(two_way_street(), 3.0, -2.0, 0.4)
        score_rollout(log, street, route)
        time_to_collision(log)
    assert sorted(name for name, count in calls.items() if count == 0) == []
