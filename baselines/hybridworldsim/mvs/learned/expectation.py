"""Depth from probabilities of hypotheses: MVSNet, Yao et al. 2018, section 3.3 and 4.1."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional


def soft_argmin(probability: Tensor, values: Tensor) -> Tensor:
    """The expectation of hypotheses.

    Args:
        probability: (D, H, W), of sum 1 over D.
        values: (D,) or (D, H, W).

    Returns:
        (H, W).
    """
    return (probability * values.reshape(len(values), *values.shape[1:], *(1,) * (3 - values.ndim))).sum(0)


def window_probability(probability: Tensor) -> Tensor:
    """The probability of the four hypotheses about the expected one, a measure of how peaked the distribution is.

    Args:
        probability: (D, H, W), of sum 1 over D.

    Returns:
        (H, W) between 0 and 1.
    """
    depths = len(probability)
    expected = soft_argmin(probability, torch.arange(depths, dtype=probability.dtype))
    index = expected.long().clamp_(0, depths - 1)
    # One before the expected hypothesis, that one, and two behind it, where there are as many.
    padded = functional.pad(probability, (0, 0, 0, 0, 1, 2))
    around = sum(padded[shift : shift + depths].gather(0, index[None]) for shift in range(4))
    return torch.as_tensor(around)[0].clamp_(0.0, 1.0)
