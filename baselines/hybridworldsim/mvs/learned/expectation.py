"""Depth from probabilities of depth hypotheses: MVSNet, Yao et al. 2018, sections 3.3 and 4.1."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional


def soft_argmin(probability: Tensor, values: Tensor) -> Tensor:
    """Compute the expectation of values over hypotheses.

    Args:
        probability: (D, H, W); sums to 1 over D.
        values: (D,) or (D, H, W).

    Returns:
        (H, W).
    """
    return (probability * values.reshape(len(values), *values.shape[1:], *(1,) * (3 - values.ndim))).sum(0)


def compute_window_probability(probability: Tensor) -> Tensor:
    """Sum the probability of the four hypotheses around the expected one: high for a peaked distribution.

    Args:
        probability: (D, H, W); sums to 1 over D.

    Returns:
        (H, W) between 0 and 1.
    """
    depths = len(probability)
    expected = soft_argmin(probability, torch.arange(depths, dtype=probability.dtype, device=probability.device))
    index = expected.long().clamp_(0, depths - 1)
    # The window is the expected hypothesis, the one before it and the two after it; zeros pad both ends.
    padded = functional.pad(probability, (0, 0, 0, 0, 1, 2))
    total = sum(padded[shift : shift + depths].gather(0, index[None]) for shift in range(4))
    return torch.as_tensor(total)[0].clamp_(0.0, 1.0)
