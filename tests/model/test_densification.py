"""Pruning, growth and splitting of Gaussians, and the limits of their number."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from hybridworldsim.model.densification.anchors import AnchorRefiner
from hybridworldsim.model.densification.cells import cell_keys
from hybridworldsim.model.densification.code_gaussians import CodeRefiner
from hybridworldsim.model.densification.image_gradients import ImageGradients
from hybridworldsim.model.densification.schedule import target_count
from hybridworldsim.model.lazy_adam import LazyAdam
from hybridworldsim.model.nodes.anchors import Anchors
from hybridworldsim.model.nodes.code_gaussians import CodeGaussians, Seeds
from hybridworldsim.model.settings import AnchorRefinement
from hybridworldsim.model.splats import DecodedSplats
from hybridworldsim.trainable.viewpoint import Viewpoint, to_viewpoint
from tests.draws import draws
from tests.model.streets import view

K = 2
PLENTY = AnchorRefinement(times=10, max_anchors=100)
VIEWPOINT = to_viewpoint(view(), np.zeros(3))


def all_shown(lengths: torch.Tensor) -> ImageGradients:
    """Gradients of all Gaussians of a part, each of which the image shows."""
    return ImageGradients(torch.arange(len(lengths)), lengths, torch.ones_like(lengths))


def anchors(count: int, apart_m: float = 5.0) -> Anchors:
    """Anchors in a row along x, each with its own code; the Gaussians lie at the anchors."""
    torch.manual_seed(0)
    means = torch.zeros(count, 3)
    means[:, 0] = apart_m * torch.arange(count) + 0.05
    node = Anchors(means, torch.ones(count), 75.0, offsets=K, code=4, latent=2, hidden=4)
    node.codes.data = torch.arange(4.0 * count).view(count, 4)
    node.offsets.data.zero_()
    return node


def decoded(node: Anchors, opacities: Tensor, visible_ids: Tensor | None = None) -> DecodedSplats:
    """Gaussians of some anchors with given opacities."""
    ids = torch.arange(len(node)) if visible_ids is None else visible_ids
    rows = (ids[:, None] * K + torch.arange(K)).flatten()
    none = torch.zeros(len(rows), 3)
    own = opacities.repeat_interleave(K)
    return DecodedSplats(none, torch.zeros(len(rows), 4), none, own, none, rows, len(node) * K, len(rows), ids)


def refiner_of(node: Anchors, refinement: AnchorRefinement = PLENTY) -> tuple[AnchorRefiner, LazyAdam]:
    tables = LazyAdam(node, Anchors.TABLES)
    return AnchorRefiner(node, tables, refinement), tables


def accumulate(
    refiner: AnchorRefiner, part: DecodedSplats, gradients: Tensor, times: int, viewpoint: Viewpoint = VIEWPOINT
) -> None:
    for _ in range(times):
        refiner.accumulate(part, all_shown(gradients), viewpoint)


def test_transparent_anchors_are_removed_after_enough_visits() -> None:
    node = anchors(6)
    refiner, tables = refiner_of(node)
    codes = node.codes.detach().clone()
    # Two anchors are transparent: one is visited nine times, the other ten times.
    opacities = torch.full((6,), 0.8)
    opacities[[1, 4]] = 0.001
    accumulate(refiner, decoded(node, opacities), torch.zeros(6 * K), 9)
    accumulate(refiner, decoded(node, opacities[1:], torch.arange(1, 6)), torch.zeros(5 * K), 1)
    refiner.refine(1, torch.Generator())
    assert tables.numbers.tolist() == [0, 2, 3, 5]
    torch.testing.assert_close(node.codes.detach(), codes[[0, 2, 3, 5]], rtol=0, atol=0)
    node = anchors(6)
    refiner, tables = refiner_of(node)
    accumulate(refiner, decoded(node, opacities), torch.zeros(6 * K), 9)
    refiner.refine(1, torch.Generator())
    assert len(node) == 6


def test_anchor_removal_uses_the_sum_of_opacities() -> None:
    node = anchors(2)
    refiner, tables = refiner_of(node)
    # Two Gaussians of 0.003 sum to 0.006, above 0.005; two of 0.002 sum to 0.004.
    accumulate(refiner, decoded(node, torch.tensor([0.003, 0.002])), torch.zeros(2 * K), 10)
    refiner.refine(1, torch.Generator())
    assert tables.numbers.tolist() == [0]


def test_anchors_grow_at_the_largest_gradients_with_their_parents_code() -> None:
    node = anchors(5)
    # The second Gaussians of anchors 1 and 3 lie 1.7 m to their left.
    for row in (1, 3):
        node.offsets.data[row, 1, 1] = 1.7
    # Only one new anchor is allowed.
    refinement = replace(PLENTY, times=100, max_anchors=25, cells_m=(1.0,), least_cell=0.0)
    assert target_count(refinement, 4, 5, refinement.max_anchors) - 5 == 1
    refiner, tables = refiner_of(node, refinement)
    gradients = torch.zeros(5 * K)
    gradients[3 * K + 1], gradients[1 * K + 1] = 9.0, 4.0
    accumulate(refiner, decoded(node, torch.ones(5)), gradients, 3)
    refiner.refine(4, torch.Generator().manual_seed(0))
    assert len(node) == 6 and tables.numbers.tolist() == [0, 1, 2, 3, 4, 5]
    # The new anchor lies in the middle of the Gaussian's cell and has the cell's size and the parent's code.
    torch.testing.assert_close(node.means.detach()[5], torch.tensor([15.5, 1.5, 0.5]))
    torch.testing.assert_close(node.log_scales.detach()[5], torch.zeros(6))
    torch.testing.assert_close(node.codes[5], node.codes[3])
    assert node.offsets[5].abs().max() <= 0.5


def test_cell_size_is_limited_by_the_nearest_distance() -> None:
    far, near = (to_viewpoint(view(x_m), np.zeros(3)) for x_m in (-400.0, -15.0))
    for viewpoint, grows in ((far, False), (near, True)):
        node = anchors(1)
        node.offsets.data[0, 1, 1] = 1.7
        refiner, _ = refiner_of(node, replace(PLENTY, cells_m=(1.0,), least_cell=0.01))
        accumulate(refiner, decoded(node, torch.ones(1)), torch.ones(K), 3, viewpoint)
        refiner.refine(10, torch.Generator())
        # One percent of 400 m is larger than the cell of 1 m.
        assert (len(node) == 2) == grows


@given(st.integers(0, 2**16), st.integers(1, 30), st.integers(0, 60))
@settings(max_examples=draws(25), deadline=None)
def test_anchors_stay_within_the_target_count(seed: int, first: int, more: int) -> None:
    rng = np.random.default_rng(seed)
    node = anchors(first, apart_m=0.7)
    refinement = replace(PLENTY, max_anchors=first + more, least_cell=0.0, cells_m=(0.8, 0.2))
    refiner, tables = refiner_of(node, refinement)
    for done in range(1, refinement.times + 1):
        opacities = torch.from_numpy(rng.choice([0.0, 0.9], len(node), p=[0.2, 0.8]).astype(np.float32))
        gradients = torch.from_numpy(rng.gamma(1.0, size=len(node) * K).astype(np.float32))
        accumulate(refiner, decoded(node, opacities), gradients, 11)
        gone = tables.numbers[opacities == 0.0].tolist()
        before = len(node) - len(gone)
        refiner.refine(done, torch.Generator().manual_seed(seed))
        assert len(node) <= max(target_count(refinement, done, first, refinement.max_anchors), before) <= first + more
        assert not set(gone) & set(tables.numbers.tolist())
        assert len(tables.numbers) == len(node) and len(set(tables.numbers.tolist())) == len(node)
        added = node.means.detach()[before:]
        # New anchors have their own cells.
        assert len(set(cell_keys(added, 0.2).tolist())) == len(added)
        # Offsets move, so that there are empty cells.
        node.offsets.data.uniform_(-1.0, 1.0)


def code_gaussians(count: int) -> CodeGaussians:
    """Gaussians in a row along x, longest along z, rotated by 90 degrees about x: along the world's minus y."""
    torch.manual_seed(0)
    means = torch.zeros(count, 3)
    means[:, 0] = 10.0 * torch.arange(count)
    turned = torch.tensor([math.cos(math.pi / 4), math.sin(math.pi / 4), 0.0, 0.0]).repeat(count, 1)
    node = CodeGaussians(Seeds(means, 3.0 * turned, torch.tensor([[0.5, 1.0, 2.0]]).repeat(count, 1), 0.9), 4, 2, 4)
    node.codes.data = torch.arange(4.0 * count).view(count, 4)
    return node


def splats(node: CodeGaussians) -> DecodedSplats:
    none = torch.zeros(len(node), 3)
    rows = torch.arange(len(node))
    return DecodedSplats(none, torch.zeros(len(node), 4), none, torch.ones(len(node)), none, rows, len(node), len(node))


def test_gaussians_with_the_largest_gradients_split_along_the_longest_axis() -> None:
    node = code_gaussians(4)
    refiner = CodeRefiner(node, LazyAdam(node, CodeGaussians.TABLES), PLENTY, 5)
    for _ in range(2):
        refiner.accumulate(splats(node), all_shown(torch.tensor([1.0, 5.0, 2.0, 0.0])))
    refiner.refine(10)
    assert len(node) == 5
    halves = node.means.detach()[3:]
    # 0.6 standard deviations of 2 m to either side.
    torch.testing.assert_close(halves, torch.tensor([[10.0, -1.2, 0.0], [10.0, 1.2, 0.0]]), rtol=0, atol=1e-5)
    torch.testing.assert_close(node.log_scales.exp()[3:], torch.tensor([[0.5, 1.0, 2.0 / 1.6]]).repeat(2, 1))
    torch.testing.assert_close(node.codes[3:], torch.arange(4.0, 8.0).repeat(2, 1))
    torch.testing.assert_close(node.logits[3:].sigmoid(), torch.full((2,), 0.9))
    assert node.means[:3, 0].tolist() == [0.0, 20.0, 30.0]


def test_transparent_gaussians_go_and_one_render_does_not_split() -> None:
    node = code_gaussians(4)
    node.logits.data[2] = -9.0
    refiner = CodeRefiner(node, LazyAdam(node, CodeGaussians.TABLES), PLENTY, 50)
    refiner.accumulate(splats(node), all_shown(torch.full((4,), 7.0)))
    refiner.refine(10)
    assert node.means[:, 0].tolist() == [0.0, 10.0, 30.0]


@given(st.integers(0, 2**16), st.integers(1, 20), st.integers(0, 40))
@settings(max_examples=draws(25), deadline=None)
def test_code_gaussians_reach_the_target_count(seed: int, first: int, more: int) -> None:
    rng = np.random.default_rng(seed)
    node = code_gaussians(first)
    refiner = CodeRefiner(node, LazyAdam(node, CodeGaussians.TABLES), PLENTY, first + more)
    for done in range(1, PLENTY.times + 1):
        for _ in range(2):
            gradients = torch.from_numpy(rng.uniform(0.1, 1.0, len(node)).astype(np.float32))
            refiner.accumulate(splats(node), all_shown(gradients))
        before = len(node)
        refiner.refine(done)
        # Splitting at most doubles the number.
        assert len(node) == min(target_count(PLENTY, done, first, first + more), 2 * before)


@pytest.mark.parametrize("count", [0, 1])
def test_empty_nodes_can_be_refined(count: int) -> None:
    node = anchors(count)
    refiner, _ = refiner_of(node)
    accumulate(refiner, decoded(node, torch.ones(count)), torch.ones(count * K), 3)
    refiner.refine(1, torch.Generator())
    assert len(node) >= count
