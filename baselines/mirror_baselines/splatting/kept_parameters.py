"""Parameters that stay on the CPU when their module moves: they are stored with a model, and Python reads them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

from torch import Tensor, nn


class KeepsParameters(nn.Module):
    """A module that moves to a device without some of its parameters.

    A number that Python reads back from a GPU waits until the GPU has computed all that was asked of it, so numbers
    that choose what is computed stay on the CPU. These parameters need no gradient.

    Attributes:
        KEPT: names of the parameters that stay.
    """

    KEPT: ClassVar[tuple[str, ...]] = ()

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Any:
        kept = {name: self.get_parameter(name).data for name in self.KEPT}
        super()._apply(fn, recurse)
        for name, tensor in kept.items():
            setattr(self, name, nn.Parameter(tensor, requires_grad=False))
        return self
