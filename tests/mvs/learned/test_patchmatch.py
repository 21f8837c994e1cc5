from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hybridworldsim.mvs.learned.source_features import SourceFeatures
from hybridworldsim.mvs.learned.warping import compute_motion
from hybridworldsim.mvs.patchmatchnet.neighbours import compute_positions, gather, make_ring, make_square
from hybridworldsim.mvs.patchmatchnet.stage import (
    FIRST_HYPOTHESES,
    LEVELS,
    InverseDepthRange,
    PatchmatchStage,
    StageEstimate,
    compute_depth_proximity,
    draw_first_hypotheses,
    make_local_hypotheses,
)
from tests.draws import draws
from tests.mvs.learned.images import make_wall_image, randomise
from tests.mvs.learned.loops import stage_by_loops


@pytest.mark.parametrize("level", LEVELS, ids=lambda level: f"stride {level.stride}")
def test_stage_equals_loops_in_float64(level):
    rng = np.random.default_rng(level.stride)
    rows, columns, stride = 5, 7, level.stride
    # A small reach keeps some neighbours inside; the formulas do not depend on the reach.
    level = replace(level, iterations=1, reach=2)
    last = stride == 2
    network = randomise(PatchmatchStage(level, last=last), stride)
    with torch.no_grad():
        network.evaluation.similarity_net.similarity.weight *= 200.0
    images = [
        make_wall_image(columns * stride, rows * stride, at)[0]
        for at in ((0.0, 0.0, 0.0), (0.6, 0.1, 0.3), (-0.4, 0.5, 0.0))
    ]
    features = 2.0 * rng.normal(size=(3, level.channels, rows, columns))
    motions = [compute_motion(images[0], source, stride) for source in images[1:]]
    depth = rng.uniform(4.0, 9.0, (rows, columns))
    weights = rng.uniform(0.1, 1.0, (2, rows, columns))
    sources = [
        SourceFeatures(torch.from_numpy(feature).float(), motion) for feature, motion in zip(features[1:], motions)
    ]
    known = StageEstimate(torch.from_numpy(depth).float(), torch.empty(0), torch.from_numpy(weights).float())
    with torch.inference_mode():
        result = network(
            torch.from_numpy(features[0]).float(),
            sources,
            InverseDepthRange(1.0 / 40.0, 1.0 / 2.0),
            known,
            torch.Generator(),
        )
    state = {key: value.double().numpy() for key, value in network.state_dict().items()}
    matrices = [(feature, motion.rotation, motion.translation) for feature, motion in zip(features[1:], motions)]
    expected, probability = stage_by_loops(state, level, features[0], matrices, 2.0, 40.0, depth, weights, last)
    np.testing.assert_allclose(result.probability.numpy(), probability, atol=2e-4)
    np.testing.assert_allclose(result.depth_m.numpy(), expected, rtol=2e-4)
    assert np.ptp(probability, axis=0).max() > 0.02


@settings(max_examples=draws(25), deadline=None)
@given(st.floats(0.1, 10.0), st.floats(1.5, 1000.0), st.integers(0, 1000))
def test_each_part_has_one_first_hypothesis(near, ratio, seed):
    inverse = InverseDepthRange(1.0 / (near * ratio), 1.0 / near)
    depths = draw_first_hypotheses(inverse, 3, 4, torch.Generator().manual_seed(seed)).double()
    place = (1.0 / depths - inverse.low) / inverse.extent * FIRST_HYPOTHESES
    part = torch.arange(FIRST_HYPOTHESES).view(-1, 1, 1)
    assert (place > part - 2e-3).all()
    assert (place < part + 1 + 2e-3).all()


def test_local_hypotheses_are_evenly_spaced_in_the_range():
    inverse = InverseDepthRange(0.1, 0.6)
    depths = make_local_hypotheses(torch.full((1, 2), 4.0), inverse, 8, 0.02).double()
    steps = 1.0 / depths[:, 0, 0] - 0.25
    np.testing.assert_allclose(steps, 0.02 * 0.5 * np.arange(-4, 4), atol=1e-7)
    clamped = 1.0 / make_local_hypotheses(torch.full((1, 1), 10.0), inverse, 8, 0.02)
    assert clamped.min() >= 0.1 - 1e-7


def test_patterns():
    assert make_ring(2) == [(-2, -2), (-2, 0), (-2, 2), (0, -2), (0, 2), (2, -2), (2, 0), (2, 2)]
    assert make_square(3)[4] == (0, 0)
    assert sorted(make_square(3)) == sorted([*make_ring(3), (0, 0)])


def test_positions_on_a_ramp():
    """Reads a ramp: each sample gives its own coordinate times W / (W - 1), half a sample to the left."""
    columns, rows = 16, 12
    ramp = torch.arange(columns).float().expand(rows, columns)[None]
    moves = torch.zeros(2, rows, columns)
    moves[0] = 0.25
    result = gather(ramp, compute_positions([(0, 2)], moves))[0, 0]
    expected = (torch.arange(columns) + 2.25) * columns / (columns - 1) - 0.5
    torch.testing.assert_close(result[3], expected.clamp(0, columns - 1))


def test_depth_proximity_is_high_on_a_level_and_falls_across_an_edge():
    inverse = InverseDepthRange(0.0125, 0.5)
    positions = compute_positions([(0, 0)], torch.zeros(2, 8, 8))
    level = compute_depth_proximity(torch.full((1, 8, 8), 5.0), inverse, positions, 0.025)
    torch.testing.assert_close(level, torch.full_like(level, float(torch.sigmoid(torch.tensor(4.0)))))
    edge = torch.full((1, 8, 8), 5.0)
    edge[:, :, 4:] = 50.0
    across = compute_depth_proximity(edge, inverse, compute_positions([(0, 4)], torch.zeros(2, 8, 8)), 0.025)
    assert float(across[0, 0, 3, 1]) == pytest.approx(float(torch.sigmoid(torch.tensor(-4.0))), rel=1e-4)


def test_hidden_sources_change_no_score():
    """Changes the features of a source that is hidden everywhere; the probabilities stay the same."""
    level = replace(LEVELS[-1], reach=2)
    network = randomise(PatchmatchStage(level, last=True), 5)
    generator = torch.Generator().manual_seed(6)
    images = [make_wall_image(16, 12, at)[0] for at in ((0.0, 0.0, 0.0), (0.6, 0.1, 0.3), (-0.4, 0.5, 0.0))]
    reference, visible, masked = (torch.randn(16, 6, 8, generator=generator) for _ in range(3))
    motions = [compute_motion(images[0], source, 2) for source in images[1:]]
    known = StageEstimate(torch.full((6, 8), 6.0), torch.empty(0), torch.full((2, 6, 8), 0.7))
    sources = [SourceFeatures(visible, motions[0]), SourceFeatures(masked, motions[1], torch.ones(6, 8))]
    other = [sources[0], SourceFeatures(-3.0 * masked, motions[1], torch.ones(6, 8))]
    with torch.inference_mode():
        first, second = (
            network(reference, features, InverseDepthRange(0.02, 0.5), known, generator).probability
            for features in (sources, other)
        )
    torch.testing.assert_close(first, second)
