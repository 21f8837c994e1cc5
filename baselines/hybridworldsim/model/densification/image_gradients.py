"""Lengths of the image-plane gradients of Gaussians."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from hybridworldsim.kernels.dispatch import is_compiled
from hybridworldsim.model.street import StreetOutput
from hybridworldsim.trainable.viewpoint import Viewpoint


class ImageGradients(NamedTuple):
    """The image-plane gradients of Gaussians of a node.

    Attributes:
        rows: (M,) int64 rows of the node's part of a render.
        lengths: (M,) lengths of the gradients in units of half the image's width and height, as in 3DGS.
        shown: (M,) 1 where the image shows the Gaussian, else 0.
    """

    rows: Tensor
    lengths: Tensor
    shown: Tensor


def image_gradients(output: StreetOutput, viewpoint: Viewpoint) -> Iterator[ImageGradients]:
    """Yield for each node the gradients of the Gaussians that the image shows.

    On a GPU they are those of all Gaussians: how many are shown is known there only, and to read it would wait.

    Args:
        output: a render, after the backward pass.
        viewpoint: camera of the render.
    """
    ids = output.meta["gaussian_ids"]
    # Summed over pixels without their signs (AbsGS): opposite gradients must not cancel.
    gradient = getattr(output.meta["means2d"], "absgrad", None)
    size = torch.tensor((viewpoint.width_px / 2.0, viewpoint.height_px / 2.0)).to(ids.device, non_blocking=True)
    lengths = torch.zeros(len(ids), device=ids.device) if gradient is None else (gradient * size).norm(dim=1)
    ends = torch.tensor([len(part) for part in output.parts]).cumsum(0)
    if not is_compiled(ids):
        every, shown = (torch.zeros(int(ends[-1]), device=ids.device) for _ in range(2))
        every.index_copy_(0, ids, lengths)
        shown.index_fill_(0, ids, 1.0)
        for end, part in zip(ends.tolist(), output.parts):
            own = slice(end - len(part), end)
            yield ImageGradients(torch.arange(len(part), device=ids.device), every[own], shown[own])
        return
    # The ids ascend.
    bounds = [0, *torch.searchsorted(ids, ends).tolist()]
    for start, stop, end, part in zip(bounds, bounds[1:], ends.tolist(), output.parts):
        found = lengths[start:stop]
        yield ImageGradients(ids[start:stop] - (end - len(part)), found, torch.ones_like(found))
