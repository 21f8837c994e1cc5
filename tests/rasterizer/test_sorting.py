"""Order by depth, against numpy's stable sort."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hybridworldsim.rasterizer.cpu.blending.sorting import depth_order
from tests.draws import draws


@settings(deadline=None, max_examples=draws(25))
@given(arrays(np.float32, st.integers(0, 6000), elements=st.floats(0.0, 2.0**100, width=32), fill=st.just(1.0)))
def test_any_depths_are_in_order_and_equal_ones_by_index(depths):
    np.testing.assert_array_equal(depth_order(depths), np.argsort(depths, kind="stable"))


@pytest.mark.parametrize("spread", ["wide", "equal", "close"])
def test_many_depths(spread):
    random = np.random.default_rng(0)
    depths = {
        "wide": random.lognormal(0.0, 15.0, 100_000),
        "equal": np.full(100_000, 3.0),
        "close": 5.0 + random.integers(0, 7, 100_000) * 1e-6,
    }[spread].astype(np.float32)
    wanted = np.argsort(depths, kind="stable")
    before = torch.get_num_threads()
    try:
        for threads in (1, 2, 5):
            torch.set_num_threads(threads)
            np.testing.assert_array_equal(depth_order(depths), wanted)
    finally:
        torch.set_num_threads(before)
