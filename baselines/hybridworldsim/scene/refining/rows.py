"""Adding and removing rows of parameters together with what Adam remembers of them."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.optim import Optimizer


def replace_rows(
    module: nn.Module, names: Sequence[str], optimizer: Optimizer, keep: Tensor, added: dict[str, Tensor]
) -> None:
    """Leave rows of parameters out and append others, whose moments are zero.

    Args:
        module: whose parameters they are.
        names: of all parameters with a row for each Gaussian or anchor.
        optimizer: that has those of them that are learnt.
        keep: (N,) int64 rows that stay.
        added: (M, ...) by name.
    """
    for name in names:
        old: nn.Parameter = getattr(module, name)
        new = nn.Parameter(torch.cat([old.detach()[keep], added[name]]), requires_grad=old.requires_grad)
        setattr(module, name, new)
        if not old.requires_grad:
            continue
        state = optimizer.state.pop(old, None)
        if state is not None:
            fresh = torch.zeros_like(added[name])
            for key in ("exp_avg", "exp_avg_sq"):
                state[key] = torch.cat([state[key][keep], fresh])
            optimizer.state[new] = state
        for group in optimizer.param_groups:
            group["params"] = [new if one is old else one for one in group["params"]]
