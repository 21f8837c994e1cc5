"""Compares what Gaussians before a depth cover with an image of these Gaussians alone."""

from __future__ import annotations

import torch
from torch import Tensor

STOPPED = 0.9
"""An image leaves out the Gaussian that would end a pixel, of alpha up to 0.999: its alpha may stop anywhere above."""


def assert_covers_are(covers: Tensor, alphas: Tensor) -> None:
    """Rounding decides whether an alpha of 1/255 counts."""
    stopped = alphas >= STOPPED
    torch.testing.assert_close(covers[~stopped], alphas[~stopped], atol=5e-4, rtol=0.0)
    assert (covers[stopped] >= alphas[stopped] - 5e-4).all() and (covers <= 1.0).all()
    assert (~stopped & (alphas > 0.05)).sum() > 100
