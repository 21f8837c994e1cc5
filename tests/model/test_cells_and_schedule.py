import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hybridworldsim.model.densification.cells import best_per_cell, cell_keys, grow_anchors
from hybridworldsim.model.densification.schedule import due_refinements, target_count
from hybridworldsim.model.settings import AnchorRefinement
from tests.draws import draws


@given(st.integers(0, 10_000), st.integers(0, 60), st.integers(0, 40), st.integers(0, 50))
@settings(max_examples=draws(60), deadline=None)
def test_new_anchors_match_exhaustive_search(seed, candidates, standing, room):
    rng = np.random.default_rng(seed)
    points = torch.from_numpy(rng.uniform(-2, 2, (candidates, 3)))
    scores = torch.from_numpy(rng.permutation(candidates).astype(np.float64))
    least = torch.from_numpy(rng.choice([0.1, 0.5, 2.0], candidates))
    occupied = torch.from_numpy(rng.uniform(-2, 2, (standing, 3)))
    sizes = (1.0, 0.4)
    centres, widths, parents = grow_anchors(points, scores, least, occupied, sizes, room)

    expected, taken, left = [], [tuple(row) for row in occupied.tolist()], room
    for remaining, size in zip((2, 1), sizes):
        full = {tuple(np.floor(np.array(row) / size).astype(int)) for row in taken}
        chosen = []
        for row in sorted(range(candidates), key=lambda row: -scores[row]):
            cell = tuple(np.floor(points[row].numpy() / size).astype(int))
            if cell in full or least[row] > size or len(chosen) == left // remaining:
                continue
            full.add(cell)
            chosen.append((row, size, (np.array(cell) + 0.5) * size))
        left -= len(chosen)
        taken += [tuple(centre) for _, _, centre in chosen]
        expected += chosen
    assert parents.tolist() == [row for row, _, _ in expected]
    assert widths.tolist() == [size for _, size, _ in expected]
    if expected:
        np.testing.assert_allclose(centres.numpy(), [centre for _, _, centre in expected])


def test_cell_keys_separate_cells():
    points = torch.tensor([[0.05, 0.0, 0.0], [-0.05, 0.0, 0.0], [0.05, 0.05, 0.0], [9e4, 0.0, -9e4], [9e4, 0.2, -9e4]])
    keys = cell_keys(points.double(), 0.1)
    assert keys[0] == keys[2]
    assert len(set(keys.tolist())) == 4


def test_the_first_of_equal_scores_is_selected():
    keys, scores = torch.tensor([7, 3, 7, 3, 9]), torch.tensor([1.0, 5.0, 1.0, 5.0, 0.0])
    assert best_per_cell(keys, scores).tolist() == [1, 0, 4]
    assert best_per_cell(keys[:0], scores[:0]).tolist() == []


def test_refinements_are_evenly_spaced_and_limited():
    refinement = AnchorRefinement(begin=0.1, end=0.6, times=10)
    assert [due_refinements(refinement, progress) for progress in (0.0, 0.1, 0.149, 0.151, 0.6, 1.0)] == [
        0,
        0,
        0,
        1,
        10,
        10,
    ]
    counts = [target_count(refinement, done, 100, 1000) for done in range(11)]
    assert counts[0] == 100
    assert counts[-1] == 1000
    assert counts == sorted(counts)
