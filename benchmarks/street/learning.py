"""Measures the parts of a training step besides rendering: two losses and the optimiser, against plain torch."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.report import Peer, Row, best_ms
from hybridworldsim.model.lazy_adam import BETA1, BETA2, LazyAdam
from hybridworldsim.model.normal_loss import normal_loss
from hybridworldsim.model.plain import losses as plain
from hybridworldsim.model.ssim_loss import ssim

WIDTH, HEIGHT = 480, 270
_KNOWN, _PATCH = 0.06, 6
"""Share of a training image's pixels with stereo depth, and the side in pixels of the patches that they form."""
_ROWS, _COLUMNS, _SEEN, _STEPS = 36_000, 32, 0.1, 30
_RATE = 2e-2


def learning_rows() -> Iterator[Row]:
    """Yield the times of value and gradient, and the largest error of the gradient, relative to its largest entry."""
    yield _curvature()
    yield _ssim_row()
    yield _adam()


def _curvature() -> Row:
    rng = np.random.default_rng(0)
    depth = 8.0 + 3.0 * torch.from_numpy(np.sin(np.linspace(0, 9, HEIGHT))[:, None] * np.cos(np.linspace(0, 7, WIDTH)))
    rendered = depth + torch.from_numpy(rng.normal(0.0, 0.02, depth.shape))
    patches = torch.from_numpy(rng.random((HEIGHT // _PATCH, WIDTH // _PATCH)) < _KNOWN)
    known = patches.repeat_interleave(_PATCH, 0).repeat_interleave(_PATCH, 1)
    K = torch.tensor([[0.6 * WIDTH, 0.0, WIDTH / 2], [0.0, 0.6 * WIDTH, HEIGHT / 2], [0.0, 0.0, 1.0]]).double()
    return _loss(
        "loss of normals", lambda one: normal_loss(one, depth.to(one.dtype), known, K),
        lambda one: plain.normal_loss(one, depth.to(one.dtype), known, K.to(one.dtype)), rendered,
    )  # fmt: skip


def _ssim_row() -> Row:
    generator = torch.Generator().manual_seed(0)
    taken = torch.rand(HEIGHT, WIDTH, 3, generator=generator).double()
    output = (taken + 0.1 * torch.randn(HEIGHT, WIDTH, 3, generator=generator)).clamp(0.0, 1.0)
    return _loss(
        "loss of structure", lambda one: 1.0 - ssim(one, taken.to(one.dtype)).mean(),
        lambda one: 1.0 - plain.structural_similarity(one, taken.to(one.dtype)).mean(), output,
    )  # fmt: skip


def _loss(name: str, ours: Callable[[Tensor], Tensor], plainly: Callable[[Tensor], Tensor], at: Tensor) -> Row:
    def gradient(loss: Callable[[Tensor], Tensor], dtype: torch.dtype) -> Tensor:
        leaf = at.detach().to(dtype).requires_grad_()
        (found,) = torch.autograd.grad(loss(leaf), leaf)
        return found.double()

    to_float64 = gradient(plainly, torch.float64)
    error, peer = (
        float((gradient(loss, torch.float32) - to_float64).abs().max() / to_float64.abs().max())
        for loss in (ours, plainly)
    )
    peers = (Peer("torch, float32", best_ms(lambda: gradient(plainly, torch.float32)), peer),)
    return Row(
        name, f"{WIDTH} x {HEIGHT}", best_ms(lambda: gradient(ours, torch.float32)), error, peers, "of the largest"
    )


def _adam() -> Row:
    seen = [_some(step) for step in range(_STEPS)]
    lazy, whole, to_float64 = (_Table(dtype) for dtype in (torch.float32, torch.float32, torch.float64))
    adam = LazyAdam(lazy, ("codes",))
    plainly, truly = (
        torch.optim.Adam(one.parameters(), lr=_RATE, betas=(BETA1, BETA2), eps=1e-15) for one in (whole, to_float64)
    )

    def run_lazy_adam(step: int) -> None:
        rows, gradients = seen[step % _STEPS]
        adam.begin_step(rows, {"codes": _RATE})["codes"].grad = gradients
        adam.end_step()

    def all_rows(table: _Table, optimiser: torch.optim.Adam, step: int) -> None:
        rows, gradients = seen[step % _STEPS]
        table.codes.grad = torch.zeros_like(table.codes).index_copy_(0, rows, gradients.to(table.codes.dtype))
        optimiser.step()

    for step in range(_STEPS):
        run_lazy_adam(step)
        all_rows(whole, plainly, step)
        all_rows(to_float64, truly, step)
    adam.catch_up({"codes": _RATE})
    error, peer = (
        float((one.codes.detach().double() - to_float64.codes.detach()).abs().max()) for one in (lazy, whole)
    )
    return Row(
        "a step of Adam",
        f"{_ROWS} x {_COLUMNS}, {_SEEN:.0%} of the rows seen",
        best_ms(lambda: run_lazy_adam(0)),
        error,
        (Peer("torch.optim.Adam, all rows", best_ms(lambda: all_rows(whole, plainly, 0)), peer),),
        f"after {_STEPS} steps of {_RATE:g}",
    )


class _Table(nn.Module):
    def __init__(self, dtype: torch.dtype) -> None:
        super().__init__()
        first = torch.randn(_ROWS, _COLUMNS, generator=torch.Generator().manual_seed(1))
        self.codes = nn.Parameter(first.to(dtype))


def _some(step: int) -> tuple[Tensor, Tensor]:
    rng = np.random.default_rng(step)
    rows = np.sort(rng.choice(_ROWS, int(_SEEN * _ROWS), replace=False)).astype(np.int64)
    return torch.from_numpy(rows), torch.from_numpy(rng.normal(size=(len(rows), _COLUMNS)).astype(np.float32))
