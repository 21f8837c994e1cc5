"""The small networks that decode Gaussians from codes, the appearance, the direction and the place."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable


class Conditioned(nn.Module):
    """A network of one hidden layer that an appearance conditions: what a picture pays for once, not for each row.

    The appearance adds to the hidden layer's bias and, where the network is bent, to the matrix that reads the codes:
    each appearance then has a network of its own, of as many degrees of freedom as its latent has.

    Args:
        code: size of the codes, which are learnt.
        beside: size of what stands beside a code and is given.
        latent: size of the appearance.
        hidden: width.
        outputs: size of the output.
        bent: whether the appearance bends the matrix of the codes.
    """

    def __init__(self, code: int, beside: int, latent: int, hidden: int, outputs: int, *, bent: bool) -> None:
        super().__init__()
        joint = nn.Linear(code + beside + latent, hidden)
        own, shared = joint.weight.detach().split([code + beside, latent], dim=1)
        self.code = code
        self.own, self.shared = nn.Parameter(own.clone()), nn.Parameter(shared.clone())
        self.bias = nn.Parameter(joint.bias.detach().clone())
        self.bend = nn.Parameter(torch.zeros(hidden * code, latent)) if bent else None
        self.out = nn.Linear(hidden, outputs)

    def first(self, latent: Tensor) -> tuple[Tensor, Tensor]:
        """Matrix (hidden, code + beside) and bias (hidden,) of the first layer under an appearance (latent,)."""
        bias = self.bias + self.shared @ latent
        if self.bend is None:
            return self.own, bias
        of_codes, others = self.own.tensor_split([self.code], dim=1)
        return torch.cat((of_codes + (self.bend @ latent).view_as(of_codes), others), dim=1), bias

    def forward(self, codes: Tensor, beside: Tensor, latent: Tensor) -> Tensor:
        """(N, outputs) of codes (N, code), what stands beside them (N, beside), and an appearance (latent,)."""
        found: Tensor = _Perceptron.apply(codes, beside, *self.first(latent), self.out.weight, self.out.bias)
        return found


class _Perceptron(torch.autograd.Function):
    """``out(relu(first(codes, beside)))`` in as few and as large products as there can be; no gradient to `beside`."""

    @staticmethod
    def forward(
        ctx: Any, codes: Tensor, beside: Tensor, first: Tensor, first_bias: Tensor, last: Tensor, last_bias: Tensor
    ) -> Tensor:
        inputs = torch.cat((codes, beside), dim=1)
        hidden = torch.addmm(first_bias, inputs, first.T).relu_()
        ctx.save_for_backward(inputs, hidden, first, last)
        ctx.code = codes.shape[1]
        return torch.addmm(last_bias, hidden, last.T)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        (gradient,) = gradients
        inputs, hidden, first, last = ctx.saved_tensors
        to_hidden = torch.ops.aten.threshold_backward(gradient @ last, hidden, 0.0)
        return (
            to_hidden @ first[:, : ctx.code],
            None,
            to_hidden.T @ inputs,
            to_hidden.sum(0),
            gradient.T @ hidden,
            gradient.sum(0),
        )
