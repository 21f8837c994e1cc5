"""How strongly an image pulls at what it shows."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from hybridworldsim.model.street import RenderOutput
from hybridworldsim.training.viewpoint import Viewpoint


def image_gradients(drawn: RenderOutput, viewpoint: Viewpoint) -> Iterator[tuple[Tensor, Tensor]]:
    """For each node the Gaussians that the image shows, and how strongly it pulls at their places in it.

    Args:
        drawn: after the backward pass.
        viewpoint: the camera.

    Returns:
        Pairs: (M,) int64 rows of the node's part of `drawn`, (M,) lengths of the gradients in half widths and heights
        of the image, as 3DGS has them.
    """
    ids = drawn.meta["gaussian_ids"]
    # Summed over pixels without their signs (AbsGS): what is pulled apart must not cancel.
    gradient = getattr(drawn.meta["means2d"], "absgrad", None)
    size = torch.tensor((viewpoint.width_px / 2.0, viewpoint.height_px / 2.0))
    lengths = torch.zeros(len(ids)) if gradient is None else (gradient * size).norm(dim=1)
    ends = torch.tensor([len(part) for part in drawn.parts]).cumsum(0)
    # The ids of an image ascend.
    bounds = [0, *torch.searchsorted(ids, ends).tolist()]
    for start, stop, end, part in zip(bounds, bounds[1:], ends.tolist(), drawn.parts):
        yield ids[start:stop] - (end - len(part)), lengths[start:stop]
