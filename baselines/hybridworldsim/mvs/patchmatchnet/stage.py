"""Patchmatch at one level of the feature pyramid; Wang et al. 2021, section 3.2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from hybridworldsim.mvs.learned.expectation import soft_argmin
from hybridworldsim.mvs.learned.source_features import SourceFeatures
from hybridworldsim.mvs.patchmatchnet.neighbours import compute_positions, gather, make_ring, make_square
from hybridworldsim.mvs.patchmatchnet.scores import GroupScore, MatchEvaluation, compute_group_similarity

FIRST_HYPOTHESES = 48
_MIN_WEIGHT = 1e-5
_NEIGHBOURS = 9


@dataclass(frozen=True)
class PyramidLevel:
    """The published settings of a stage.

    Attributes:
        stride: stride of the features.
        channels: channels of the features.
        groups: number of groups of channels; the similarity is computed per group.
        iterations: iterations of patchmatch.
        hypotheses: number of hypotheses around the current depth.
        interval: distance between hypotheses, as a share of the range of inverse depths.
        reach: reach of the fixed pattern of propagation, in samples; the pattern of aggregation reaches one less.
        propagated: number of hypotheses taken from neighbours.
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
    PyramidLevel(8, 64, 8, iterations=2, hypotheses=16, interval=0.025, reach=2, propagated=16),
    PyramidLevel(4, 32, 8, iterations=2, hypotheses=8, interval=0.0125, reach=4, propagated=8),
    PyramidLevel(2, 16, 4, iterations=1, hypotheses=8, interval=0.005, reach=6, propagated=0),
)


@dataclass(frozen=True, eq=False)
class InverseDepthRange:
    """A range of inverse depths, 1 / m."""

    low: float
    high: float

    @property
    def extent(self) -> float:
        """The difference of the highest and the lowest inverse depth, 1 / m."""
        return self.high - self.low


@dataclass(frozen=True, eq=False)
class StageEstimate:
    """The result of a stage.

    Attributes:
        depth_m: (H, W).
        probability: (D, H, W) probabilities of the last hypotheses.
        view_weights: (V, H, W) weight of each source, from 0 to 1.
    """

    depth_m: Tensor
    probability: Tensor
    view_weights: Tensor


class PatchmatchStage(nn.Module):
    """Patchmatch at one level of the pyramid.

    Args:
        level: the settings.
        last: whether this is the finest level, at which depth is the expectation of inverse depth at the end.
    """

    def __init__(self, level: PyramidLevel, *, last: bool) -> None:
        super().__init__()
        self.level, self.last = level, last
        self.evaluation = MatchEvaluation(level.groups)
        self.propa_conv = _make_offset_convolution(level, max(2 * level.propagated, 1))
        self.eval_conv = _make_offset_convolution(level, 2 * _NEIGHBOURS)
        self.feature_weight_net = GroupScore(level.groups, "similarity")

    def forward(
        self,
        reference: Tensor,
        sources: Sequence[SourceFeatures],
        inverse: InverseDepthRange,
        start: StageEstimate | None,
        generator: torch.Generator,
    ) -> StageEstimate:
        """Estimate the depth of the reference at this level.

        Args:
            reference: (C, H, W) features.
            sources: at least one.
            inverse: range that is searched.
            start: estimate of the coarser level, resized to this level; None at the coarsest level.
            generator: of the first hypotheses' random numbers.
        """
        positions = compute_positions(make_square(self.level.reach - 1), self.eval_conv(reference[None])[0])
        similarity_weights = torch.sigmoid(
            self.feature_weight_net(
                compute_group_similarity(gather(reference, positions), reference, self.level.groups)
            )
        )
        donor_positions = self._compute_donor_positions(reference)
        estimate = start
        for iteration in range(self.level.iterations):
            if estimate is None:
                depths = draw_first_hypotheses(inverse, reference.shape[1], reference.shape[2], generator)
                depths = depths.to(reference.device)
            else:
                depths = make_local_hypotheses(estimate.depth_m, inverse, self.level.hypotheses, self.level.interval)
            if donor_positions is not None:
                propagated = gather(depths[len(depths) // 2][None], donor_positions)[0]
                depths = torch.cat((depths, propagated)).sort(dim=0).values
            weights = compute_depth_proximity(depths, inverse, positions, self.level.interval).mul_(similarity_weights)
            weights /= weights.sum(1, keepdim=True)
            matched, view_weights = self._match(reference, sources, depths, estimate)
            score = (gather(self.evaluation.similarity_net(matched), positions) * weights).sum(1)
            probability = score.softmax(0)
            finest = self.last and iteration == self.level.iterations - 1
            depth = compute_inverse_expectation(probability, depths) if finest else soft_argmin(probability, depths)
            estimate = StageEstimate(depth, probability, view_weights)
        if estimate is None:
            raise RuntimeError("the stage has no iterations")
        return estimate

    def _compute_donor_positions(self, reference: Tensor) -> Tensor | None:
        """Compute the neighbour positions (N, H, W, 2) that give hypotheses; None if this level does not propagate."""
        if self.level.propagated == 0:
            return None
        inner = make_ring(self.level.reach)
        outer = [(2 * down, 2 * right) for down, right in inner]
        return compute_positions((inner + outer)[: self.level.propagated], self.propa_conv(reference[None])[0])

    def _match(
        self, reference: Tensor, sources: Sequence[SourceFeatures], depths: Tensor, known: StageEstimate | None
    ) -> tuple[Tensor, Tensor]:
        """Compute the weighted mean similarity (G, D, H, W) over the sources, and the sources' weights (V, H, W)."""
        total, weights = torch.zeros((), device=depths.device), []
        total_weight = torch.tensor(_MIN_WEIGHT, device=depths.device)
        for number, source in enumerate(sources):
            warped, evidence = source.warp(depths)
            similarity = compute_group_similarity(warped, reference, self.level.groups)
            weight = self.evaluation.compute_view_weight(similarity) if known is None else known.view_weights[number]
            weights.append(weight)
            total = similarity.mul_(weight).add_(total)
            total_weight = total_weight + weight * evidence
        return total.div_(total_weight), torch.stack(weights)


def draw_first_hypotheses(inverse: InverseDepthRange, rows: int, columns: int, generator: torch.Generator) -> Tensor:
    """Draw depths (48, rows, columns): one at random from each of 48 equal parts of the range of inverse depths."""
    random = torch.rand((FIRST_HYPOTHESES, rows, columns), generator=generator)
    share = (random + torch.arange(FIRST_HYPOTHESES).view(-1, 1, 1)).div_(FIRST_HYPOTHESES)
    return share.mul_(inverse.extent).add_(inverse.low).reciprocal_()


def make_local_hypotheses(depth_m: Tensor, inverse: InverseDepthRange, count: int, interval: float) -> Tensor:
    """Make depths (count, H, W) around known depths (H, W), evenly spaced in inverse depth, within the range."""
    steps = torch.arange(-(count // 2), count - count // 2, device=depth_m.device).view(-1, 1, 1) * (
        interval * inverse.extent
    )
    return (depth_m.reciprocal() + steps).clamp_(inverse.low, inverse.high).reciprocal_()


def compute_depth_proximity(depths: Tensor, inverse: InverseDepthRange, positions: Tensor, interval: float) -> Tensor:
    """Compute how close each hypothesis (D, H, W) is to the same hypothesis at N neighbours: (D, N, H, W), 0 to 1."""
    share = (depths.reciprocal() - inverse.low) / inverse.extent
    steps = (gather(share, positions) - share[:, None]).abs_().div_(interval).clamp_(max=4.0)
    return torch.sigmoid(4.0 - 2.0 * steps)


def compute_inverse_expectation(probability: Tensor, depths: Tensor) -> Tensor:
    """Compute depth (H, W) at the expected index of hypotheses (D, H, W) that are evenly spaced in inverse depth."""
    last = len(depths) - 1
    index = soft_argmin(probability, torch.arange(last + 1, dtype=probability.dtype, device=depths.device))
    first = depths[0].reciprocal()
    return (first + index / last * (depths[-1].reciprocal() - first)).reciprocal_()


def _make_offset_convolution(level: PyramidLevel, outputs: int) -> nn.Conv2d:
    return nn.Conv2d(level.channels, outputs, 3, padding=level.reach, dilation=level.reach)
