"""The small networks that decode Gaussians from codes, the appearance, the direction and the place."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional


class Conditioned(nn.Module):
    """A network of one hidden layer, part of whose input is the same for all rows.

    What all rows share (the appearance) is a bias of the hidden layer, so that a picture pays for it once.

    Args:
        inputs: sizes of the inputs that rows differ in; each has its own matrix, so that they need not be joined.
        shared: size of what all rows share.
        hidden: width.
        outputs: size of the output.
    """

    def __init__(self, inputs: tuple[int, ...], shared: int, hidden: int, outputs: int) -> None:
        super().__init__()
        joint = nn.Linear(sum(inputs) + shared, hidden)
        parts = joint.weight.detach().split([*inputs, shared], dim=1)
        self.own = nn.ParameterList([nn.Parameter(part.clone()) for part in parts[:-1]])
        self.shared = nn.Parameter(parts[-1].clone())
        self.bias = nn.Parameter(joint.bias.detach().clone())
        self.out = nn.Linear(hidden, outputs)

    def forward(self, inputs: tuple[Tensor, ...], shared: Tensor) -> Tensor:
        """(N, outputs) of inputs (N, ...) and of what they share."""
        bias = self.bias + self.shared @ shared
        hidden = torch.addmm(bias, inputs[0], self.own[0].T)
        for matrix, values in zip(list(self.own)[1:], inputs[1:]):
            hidden = torch.addmm(hidden, values, matrix.T)
        return self.out(functional.relu(hidden))
