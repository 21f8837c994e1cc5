import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from hybridworldsim.mvs.learned.expectation import compute_window_probability, soft_argmin
from hybridworldsim.mvs.mvsnet.planes import DepthPlanes
from hybridworldsim.mvs.patchmatchnet.stage import compute_inverse_expectation


def test_soft_argmin_of_a_geometric_series():
    """Compares with the closed form: scores that fall by log 2 per step have the mean sum k 2^-k / sum 2^-k."""
    count = 12
    probability = (-np.log(2.0) * torch.arange(count, dtype=torch.float64)).softmax(0).view(-1, 1, 1)
    power = 0.5 ** np.arange(count)
    expected = (np.arange(count) * power).sum() / power.sum()
    # In closed form: 1 - count / (2^count - 1).
    assert expected == pytest.approx(1.0 - count / (2.0**count - 1.0), abs=1e-12)
    result = soft_argmin(probability, torch.arange(count, dtype=torch.float64))
    assert float(result) == pytest.approx(expected, abs=1e-12)


def test_soft_argmin_with_values_per_pixel():
    probability = torch.tensor([0.25, 0.75]).view(2, 1, 1).expand(2, 3, 4)
    values = torch.arange(24.0).view(2, 3, 4)
    torch.testing.assert_close(soft_argmin(probability, values), 0.25 * values[0] + 0.75 * values[1])


@given(st.integers(4, 40), st.data())
def test_window_of_a_single_plane(count, data):
    plane = data.draw(st.integers(0, count - 1))
    single = torch.zeros(count, 1, 1)
    single[plane] = 1.0
    assert float(compute_window_probability(single)) == 1.0


def test_window_of_uniform_and_bimodal_probabilities():
    uniform = torch.full((64, 2, 3), 1.0 / 64.0)
    torch.testing.assert_close(compute_window_probability(uniform), torch.full((2, 3), 4.0 / 64.0))
    bimodal = torch.zeros(64, 1, 1)
    bimodal[4] = bimodal[60] = 0.5
    assert float(compute_window_probability(bimodal)) == 0.0


def test_window_at_the_last_plane():
    last = torch.zeros(8, 1, 1)
    last[6] = last[7] = 0.5
    assert float(compute_window_probability(last)) == pytest.approx(1.0)


@pytest.mark.parametrize("spacing", ["depth", "inverse_depth"])
def test_planes_span_near_to_far_evenly(spacing):
    depths = DepthPlanes(2.0, 200.0, 96, spacing).depths_m().double()
    assert depths[0] == pytest.approx(2.0, rel=1e-6)
    assert depths[-1] == pytest.approx(200.0, rel=1e-6)
    steps = (depths if spacing == "depth" else 1.0 / depths).diff()
    assert steps.std() < 1e-5 * steps.abs().mean()


def test_inverse_expectation_between_two_hypotheses():
    depths = 1.0 / torch.linspace(0.1, 0.5, 5, dtype=torch.float64).view(-1, 1, 1)
    probability = torch.tensor([0.0, 0.0, 0.5, 0.5, 0.0], dtype=torch.float64).view(-1, 1, 1)
    assert float(compute_inverse_expectation(probability, depths)) == pytest.approx(1.0 / 0.35, rel=1e-12)
