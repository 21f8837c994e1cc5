"""The conditions of a clip's frames, as tensors of the network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.network.conditions import Conditions
from hybridworldsim.generation.network.configuration import TransformerConfig
from hybridworldsim.generation.text import TextEmbedding
from mirror.arrays import Float32
from mirror.errors import UsageError


def frame_conditions(
    clip: Clip, frame: int, config: TransformerConfig, layout: Float32 | None, text: TextEmbedding | None = None
) -> Conditions:
    """The conditions of one frame.

    Args:
        clip: the clip.
        frame: number of the frame.
        config: the network; conditions that it does not take are left out.
        layout: (V, channels, height, width) from `draw_layout`.
        text: caption of all views; None: no text.

    Raises:
        UsageError: the network takes a layout and none is given.
    """
    if config.layout is not None and layout is None:
        raise UsageError("no layout", place=f"{clip.clip_id}, frame {frame}", expected="the images of `draw_layout`")
    height, width = clip.size_px
    views = len(clip.views)
    embedding = TextEmbedding.empty(config) if text is None else text
    unit = clip.intrinsics / np.array([width, height, 1.0])[:, None]
    background = torch.from_numpy(clip.background[frame]).movedim(-1, -3).float() / 255.0
    return Conditions(
        clip.size_px,
        _batched(unit),
        _batched(clip.ego_SE3_camera),
        _batched(clip.start_SE3_ego[frame]),
        torch.tensor([clip.rate_hz]),
        embedding.tokens.expand(1, 1, views, -1, -1),
        embedding.pooled.expand(1, 1, views, -1),
        None if config.layout is None or layout is None else torch.from_numpy(layout)[None, None],
        None if config.background is None else background[None, None],
        torch.from_numpy(clip.present[frame])[None, None],
    )


def stack_conditions(windows: Sequence[Conditions]) -> Conditions:
    """Stack conditions of single sequences to a batch; all must have the same tensors."""
    stacked: dict[str, Any] = {}
    for field in fields(Conditions):
        tensors = [getattr(one, field.name) for one in windows]
        if isinstance(tensors[0], Tensor) and field.name != "view_index":
            stacked[field.name] = torch.cat(tensors)
    return replace(windows[0], **stacked)


def _batched(matrix: Any) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(matrix, np.float32))[None, None]
