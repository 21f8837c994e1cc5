"""The small networks that decode Gaussians from codes, the appearance, the viewing direction and the place."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable


class ModulatedMLP(nn.Module):
    """A network with one hidden layer that an appearance modulates once for an image, not for each row.

    The appearance adds to the bias of the hidden layer. If the network is modulated, it also adds to the matrix that
    reads the codes, so that each appearance has its own network, with as many degrees of freedom as its latent.

    Args:
        code: size of the codes, which are learned.
        beside: number of other inputs beside a code: direction and place.
        latent: size of the appearance.
        hidden: width of the hidden layer.
        outputs: size of the output.
        modulated: whether the appearance changes the matrix that reads the codes.
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

    def first_layer(self, latent: Tensor, width: int) -> Tensor:
        """Return the first layer (hidden, width) under an appearance: matrix, bias, and zeros up to the width.

        Args:
            latent: (latent,) the appearance.
            width: number of columns of the network's input.
        """
        matrix: Tensor = self.own
        if self.bend is not None:
            of_codes, others = matrix.tensor_split([self.code], dim=1)
            matrix = torch.cat((of_codes + (self.bend @ latent).view_as(of_codes), others), dim=1)
        bias = self.bias + self.shared @ latent
        return torch.cat((matrix, bias[:, None], matrix.new_zeros(len(matrix), width - matrix.shape[1] - 1)), dim=1)


def run_mlps(network_inputs: Tensor, *networks: tuple[ModulatedMLP, Tensor]) -> tuple[Tensor, ...]:
    """Apply several networks to the same rows, each under its own appearance.

    Args:
        network_inputs: (N, code + beside + 1 or more) codes, other inputs, a column of ones, columns of zeros.
        networks: pairs of a network and an appearance (latent,).

    Returns:
        The output (N, outputs) of each network.
    """
    first_layer = torch.cat([network.first_layer(latent, network_inputs.shape[1]) for network, latent in networks])
    output_layers = [layer for network, _ in networks for layer in (network.out.weight, network.out.bias)]
    outputs: tuple[Tensor, ...] = _Perceptrons.apply(network_inputs, first_layer, *output_layers)
    return outputs


class _Perceptrons(torch.autograd.Function):
    """Several networks ``out(relu(first(inputs)))``, computed in few, large matrix products."""

    @staticmethod
    def forward(ctx: Any, inputs: Tensor, first_layer: Tensor, *output_layers: Tensor) -> tuple[Tensor, ...]:
        hidden = torch.mm(inputs, first_layer.T).relu_()
        weights = output_layers[::2]
        ctx.save_for_backward(inputs, hidden, first_layer, *weights)
        parts = hidden.split([weight.shape[1] for weight in weights], dim=1)
        return tuple(
            torch.addmm(bias, part, weight.T) for part, weight, bias in zip(parts, weights, output_layers[1::2])
        )

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        inputs, hidden, first_layer, *weights = ctx.saved_tensors
        sizes, hidden_gradient, output_gradients = [weight.shape[1] for weight in weights], torch.empty_like(hidden), []
        spans = zip(gradients, weights, hidden.split(sizes, dim=1), hidden_gradient.split(sizes, dim=1))
        for gradient, weight, part, to_part in spans:
            torch.mm(gradient, weight, out=to_part)
            output_gradients += [gradient.T @ part, gradient.sum(0)]
        torch.ops.aten.threshold_backward.grad_input(hidden_gradient, hidden, 0.0, grad_input=hidden_gradient)
        return hidden_gradient @ first_layer, hidden_gradient.T @ inputs, *output_gradients
