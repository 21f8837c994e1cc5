"""The small networks that decode Gaussians from codes, the appearance, the direction and the place."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable


class ModulatedMLP(nn.Module):
    """A network of one hidden layer that an appearance conditions: what an image pays for once, not for each row.

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

    def __init__(self, code: int, beside: int, latent: int, hidden: int, outputs: int, *, modulated: bool) -> None:
        super().__init__()
        joint = nn.Linear(code + beside + latent, hidden)
        own, shared = joint.weight.detach().split([code + beside, latent], dim=1)
        self.code = code
        self.own, self.shared = nn.Parameter(own.clone()), nn.Parameter(shared.clone())
        self.bias = nn.Parameter(joint.bias.detach().clone())
        self.bend = nn.Parameter(torch.zeros(hidden * code, latent)) if modulated else None
        self.out = nn.Linear(hidden, outputs)

    def first(self, latent: Tensor, width: int) -> Tensor:
        """(hidden, width) the first layer under an appearance (latent,): matrix, bias, and as many zeros as are asked.

        Args:
            latent: the appearance.
            width: of what the network is told.
        """
        matrix: Tensor = self.own
        if self.bend is not None:
            of_codes, others = matrix.tensor_split([self.code], dim=1)
            matrix = torch.cat((of_codes + (self.bend @ latent).view_as(of_codes), others), dim=1)
        bias = self.bias + self.shared @ latent
        return torch.cat((matrix, bias[:, None], matrix.new_zeros(len(matrix), width - matrix.shape[1] - 1)), dim=1)


def run_mlps(network_inputs: Tensor, *networks: tuple[ModulatedMLP, Tensor]) -> tuple[Tensor, ...]:
    """What networks make of the same rows, each under an appearance of its own.

    Args:
        network_inputs: (N, code + beside + 1 or more) codes, what stands beside them, a one, zeros.
        networks: each with an appearance (latent,).

    Returns:
        Of each network (N, outputs).
    """
    first = torch.cat([network.first(latent, network_inputs.shape[1]) for network, latent in networks])
    lasts = [layer for network, _ in networks for layer in (network.out.weight, network.out.bias)]
    found: tuple[Tensor, ...] = _Perceptrons.apply(network_inputs, first, *lasts)
    return found


class _Perceptrons(torch.autograd.Function):
    """``out(relu(first(inputs)))`` of several networks, in as few and as large products as there can be."""

    @staticmethod
    def forward(ctx: Any, inputs: Tensor, first: Tensor, *lasts: Tensor) -> tuple[Tensor, ...]:
        hidden = torch.mm(inputs, first.T).relu_()
        weights = lasts[::2]
        ctx.save_for_backward(inputs, hidden, first, *weights)
        parts = hidden.split([weight.shape[1] for weight in weights], dim=1)
        return tuple(torch.addmm(bias, part, weight.T) for part, weight, bias in zip(parts, weights, lasts[1::2]))

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        inputs, hidden, first, *weights = ctx.saved_tensors
        sizes, to_hidden, to_lasts = [weight.shape[1] for weight in weights], torch.empty_like(hidden), []
        spans = zip(gradients, weights, hidden.split(sizes, dim=1), to_hidden.split(sizes, dim=1))
        for gradient, weight, part, to_part in spans:
            torch.mm(gradient, weight, out=to_part)
            to_lasts += [gradient.T @ part, gradient.sum(0)]
        torch.ops.aten.threshold_backward.grad_input(to_hidden, hidden, 0.0, grad_input=to_hidden)
        return to_hidden @ first, to_hidden.T @ inputs, *to_lasts
