"""Lengths of the image-plane gradients of Gaussians."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from hybridworldsim.model.street import StreetOutput
from hybridworldsim.trainable.viewpoint import Viewpoint


def image_gradients(output: StreetOutput, viewpoint: Viewpoint) -> Iterator[tuple[Tensor, Tensor]]:
    """Yield for each node the Gaussians that the image shows and the lengths of their image-plane gradients.

    Args:
        output: a render, after the backward pass.
        viewpoint: camera of the render.

    Returns:
        Pairs: (M,) int64 rows of the node's part of `output`, (M,) gradient lengths in units of half the image's width
            and
        height, as in 3DGS.
    """
    ids = output.meta["gaussian_ids"]
    # Summed over pixels without their signs (AbsGS): opposite gradients must not cancel.
    gradient = getattr(output.meta["means2d"], "absgrad", None)
    size = torch.tensor((viewpoint.width_px / 2.0, viewpoint.height_px / 2.0)).to(ids.device, non_blocking=True)
    lengths = torch.zeros(len(ids), device=ids.device) if gradient is None else (gradient * size).norm(dim=1)
    counts = torch.tensor([len(part) for part in output.parts]).cumsum(0)
    ends = counts.to(ids.device, non_blocking=True)
    # The ids ascend.
    bounds = [0, *torch.searchsorted(ids, ends).tolist()]
    for start, stop, end, part in zip(bounds, bounds[1:], counts.tolist(), output.parts):
        yield ids[start:stop] - (end - len(part)), lengths[start:stop]
