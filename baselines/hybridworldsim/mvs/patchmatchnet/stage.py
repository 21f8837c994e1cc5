"""Patchmatch at one level of the pyramid: hypotheses, propagation, evaluation. Wang et al. 2021, section 3.2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from hybridworldsim.mvs.learned.expectation import soft_argmin
from hybridworldsim.mvs.learned.view import View
from hybridworldsim.mvs.patchmatchnet.neighbours import gather, positions_of, ring, square
from hybridworldsim.mvs.patchmatchnet.scores import Evaluation, GroupScore, group_similarity

FIRST_HYPOTHESES = 48
_NO_WEIGHT = 1e-5
_NEIGHBOURS = 9


@dataclass(frozen=True)
class Level:
    """The settings of a stage, as published.

    Attributes:
        stride: of its features.
        channels: of its features.
        groups: of channels that are compared together.
        iterations: of patchmatch.
        hypotheses: drawn about the depth that is known so far.
        interval: between them, as a share of the range of inverse depths.
        reach: of the fixed pattern of propagation, in samples; that of aggregation is one less.
        propagated: hypotheses taken over from neighbours.
    """

    stride: int
    channels: int
    groups: int
    iterations: int
    hypotheses: int
    interval: float
    reach: int
    propagated: int


LEVELS = (
    Level(8, 64, 8, iterations=2, hypotheses=16, interval=0.025, reach=2, propagated=16),
    Level(4, 32, 8, iterations=2, hypotheses=8, interval=0.0125, reach=4, propagated=8),
    Level(2, 16, 4, iterations=1, hypotheses=8, interval=0.005, reach=6, propagated=0),
)


@dataclass(frozen=True, eq=False)
class Range:
    """Inverse depths, per metre."""

    low: float
    high: float

    @property
    def extent(self) -> float:
        """From the lowest to the highest."""
        return self.high - self.low


@dataclass(frozen=True, eq=False)
class Estimate:
    """What a stage found.

    Attributes:
        depth_m: (H, W).
        probability: (D, H, W) of the last hypotheses.
        view_weights: (V, H, W) how far each source is believed.
    """

    depth_m: Tensor
    probability: Tensor
    view_weights: Tensor


class Stage(nn.Module):
    """Patchmatch at one level; the last is that of the finest.

    Args:
        level: its settings.
        last: whether depth is the expectation of inverse depth at the end.
    """

    def __init__(self, level: Level, *, last: bool) -> None:
        super().__init__()
        self.level, self.last = level, last
        self.evaluation = Evaluation(level.groups)
        self.propa_conv = _moves(level, max(2 * level.propagated, 1))
        self.eval_conv = _moves(level, 2 * _NEIGHBOURS)
        self.feature_weight_net = GroupScore(level.groups, "similarity")

    def forward(
        self, reference: Tensor, views: Sequence[View], inverse: Range, start: Estimate | None, draws: torch.Generator
    ) -> Estimate:
        """Depth of the reference at this level.

        Args:
            reference: (C, H, W) features.
            views: the sources, one at least.
            inverse: depths that are searched.
            start: of the level before, brought to this one's size; None: nothing is known yet.
            draws: for the first hypotheses.
        """
        places = positions_of(square(self.level.reach - 1), self.eval_conv(reference[None])[0])
        alike = torch.sigmoid(
            self.feature_weight_net(group_similarity(gather(reference, places), reference, self.level.groups))
        )
        donors = self._donors(reference)
        estimate = start
        for iteration in range(self.level.iterations):
            if estimate is None:
                depths = first_hypotheses(inverse, reference.shape[1], reference.shape[2], draws)
            else:
                depths = local_hypotheses(estimate.depth_m, inverse, self.level.hypotheses, self.level.interval)
            if donors is not None:
                taken = gather(depths[len(depths) // 2][None], donors)[0]
                depths = torch.cat((depths, taken)).sort(dim=0).values
            weights = near_in_depth(depths, inverse, places, self.level.interval).mul_(alike)
            weights /= weights.sum(1, keepdim=True)
            matched, view_weights = self._match(reference, views, depths, estimate)
            score = (gather(self.evaluation.similarity_net(matched), places) * weights).sum(1)
            probability = score.softmax(0)
            finest = self.last and iteration == self.level.iterations - 1
            depth = inverse_expectation(probability, depths) if finest else soft_argmin(probability, depths)
            estimate = Estimate(depth, probability, view_weights)
        if estimate is None:
            raise RuntimeError("a stage of no iterations")
        return estimate

    def _donors(self, reference: Tensor) -> Tensor | None:
        if self.level.propagated == 0:
            return None
        near = ring(self.level.reach)
        far = [(2 * down, 2 * right) for down, right in near]
        return positions_of((near + far)[: self.level.propagated], self.propa_conv(reference[None])[0])

    def _match(
        self, reference: Tensor, views: Sequence[View], depths: Tensor, known: Estimate | None
    ) -> tuple[Tensor, Tensor]:
        """Similarities (G, D, H, W) over all sources, and how far each of those is believed (V, H, W)."""
        total, believed, weights = torch.zeros(()), torch.tensor(_NO_WEIGHT), []
        for number, view in enumerate(views):
            seen, evidence = view.seen(depths)
            similarity = group_similarity(seen, reference, self.level.groups)
            weight = self.evaluation.view_weight(similarity) if known is None else known.view_weights[number]
            weights.append(weight)
            total = similarity.mul_(weight).add_(total)
            believed = believed + weight * evidence
        return total.div_(believed), torch.stack(weights)


def first_hypotheses(inverse: Range, rows: int, columns: int, draws: torch.Generator) -> Tensor:
    """(48, rows, columns) depths: one drawn evenly from each of as many equal parts of the range of inverse depths."""
    drawn = torch.rand((FIRST_HYPOTHESES, rows, columns), generator=draws)
    share = (drawn + torch.arange(FIRST_HYPOTHESES).view(-1, 1, 1)).div_(FIRST_HYPOTHESES)
    return share.mul_(inverse.extent).add_(inverse.low).reciprocal_()


def local_hypotheses(depth_m: Tensor, inverse: Range, count: int, interval: float) -> Tensor:
    """(count, H, W) depths about (H, W) known ones, evenly spaced in inverse depth, within the range."""
    steps = torch.arange(-(count // 2), count - count // 2).view(-1, 1, 1) * (interval * inverse.extent)
    return (depth_m.reciprocal() + steps).clamp_(inverse.low, inverse.high).reciprocal_()


def near_in_depth(depths: Tensor, inverse: Range, places: Tensor, interval: float) -> Tensor:
    """(D, N, H, W) from 0 to 1: how near each hypothesis (D, H, W) is to that of each of N places."""
    share = (depths.reciprocal() - inverse.low) / inverse.extent
    steps = (gather(share, places) - share[:, None]).abs_().div_(interval).clamp_(max=4.0)
    return torch.sigmoid(4.0 - 2.0 * steps)


def inverse_expectation(probability: Tensor, depths: Tensor) -> Tensor:
    """(H, W) depth at the expected index of hypotheses (D, H, W) that are evenly spaced in inverse depth."""
    last = len(depths) - 1
    index = soft_argmin(probability, torch.arange(last + 1, dtype=probability.dtype))
    first = depths[0].reciprocal()
    return (first + index / last * (depths[-1].reciprocal() - first)).reciprocal_()


def _moves(level: Level, outputs: int) -> nn.Conv2d:
    return nn.Conv2d(level.channels, outputs, 3, padding=level.reach, dilation=level.reach)
