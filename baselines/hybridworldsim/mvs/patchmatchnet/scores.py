"""The small networks that score similarities; each sample is scored on its own."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from hybridworldsim.mvs.learned.layers import ConvNormReLU


class GroupScore(nn.Module):
    """A network that maps the similarities of G groups to one score, by three layers of 16, 8 and 1 channels.

    Args:
        groups: G.
        last: name of the last layer in the published checkpoint.
    """

    def __init__(self, groups: int, last: str) -> None:
        super().__init__()
        self.conv0 = ConvNormReLU(3, groups, 16, size=1)
        self.conv1 = ConvNormReLU(3, 16, 8, size=1)
        self.add_module(last, nn.Conv3d(8, 1, 1))
        self._last = last

    def forward(self, similarity: Tensor) -> Tensor:
        """Compute scores (D, H, W) of similarities (G, D, H, W)."""
        return self.get_submodule(self._last)(self.conv1(self.conv0(similarity[None])))[0, 0]


class MatchEvaluation(nn.Module):
    """The two networks of matching: one scores hypotheses, the other weights the sources at each sample."""

    def __init__(self, groups: int) -> None:
        super().__init__()
        self.pixel_wise_net = GroupScore(groups, "conv2")
        self.similarity_net = GroupScore(groups, "similarity")

    def compute_view_weight(self, similarity: Tensor) -> Tensor:
        """Compute the weight (H, W) of a source, from 0 to 1, from its similarities (G, D, H, W)."""
        return torch.sigmoid(self.pixel_wise_net(similarity)).amax(0)


def compute_group_similarity(first: Tensor, second: Tensor, groups: int) -> Tensor:
    """Compute the mean product of features over the channels of each group.

    Args:
        first: (C, D, H, W); the function overwrites it.
        second: (C, H, W).
        groups: G, a divisor of C.

    Returns:
        (G, D, H, W).
    """
    product = first.mul_(second[:, None])
    return product.view(groups, -1, *first.shape[1:]).mean(1)
