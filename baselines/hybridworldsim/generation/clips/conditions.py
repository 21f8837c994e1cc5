"""The conditions of a clip's frames, as tensors of the network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.generation.autoencoder.codec import from_levels
from hybridworldsim.generation.clips.captions import Captions, TextEmbedding, embed_views, require_equal_lengths
from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.network.conditions import Conditions
from hybridworldsim.generation.network.configuration import TransformerConfig
from mirror.arrays import Float32, Float64
from mirror.errors import UsageError


def frame_conditions(
    clip: Clip,
    frame: int,
    config: TransformerConfig,
    layout: Float32 | None,
    captions: Captions | None = None,
    *,
    ring: bool = False,
    background: Tensor | None = None,
) -> Conditions:
    """Return the conditions of one frame.

    Args:
        clip: the clip.
        frame: number of the frame.
        config: the network; conditions that it does not take are left out.
        layout: (V, channels, height, width) from `draw_layout`.
        captions: captions of the views; None: no text.
        ring: whether a view attends only to the views before and behind it in the rig, the first being behind the last.
        background: (V, height, width, 3) uint8, the images of the empty street on any device; None: those of the clip.

    Raises:
        UsageError: the network takes a layout and none is given, or a caption does not fit.
    """
    if config.layout is not None and layout is None:
        raise UsageError("no layout", place=f"{clip.clip_id}, frame {frame}", expected="the images of `draw_layout`")
    height, width = clip.size_px
    views = len(clip.views)
    text = TextEmbedding.empty(config) if captions is None else embed_views(captions, clip, frame, config)
    unit = clip.intrinsics / np.array([width, height, 1.0])[:, None]
    shown = torch.from_numpy(clip.background[frame]) if background is None else background
    return Conditions(
        clip.size_px,
        _batched(unit),
        _batched(clip.cameras_at(frame)),
        _batched(clip.start_SE3_ego[frame]),
        torch.tensor([clip.rate_hz]),
        text.tokens.expand(1, 1, views, -1, -1),
        text.pooled.expand(1, 1, views, -1),
        None if config.layout is None or layout is None else torch.from_numpy(layout)[None, None],
        None if config.background is None else from_levels(shown)[None, None],
        torch.from_numpy(clip.present[frame])[None, None],
        _ring(clip.ego_SE3_camera)[None] if ring else None,
    )


def stack_conditions(windows: Sequence[Conditions]) -> Conditions:
    """Stack the conditions of single sequences to a batch; all sequences must have the same tensors.

    Raises:
        UsageError: captions have different numbers of tokens.
    """
    require_equal_lengths(one.text for one in windows)
    stacked: dict[str, Any] = {}
    for field in fields(Conditions):
        tensors = [getattr(one, field.name) for one in windows]
        if isinstance(tensors[0], Tensor) and field.name != "view_index":
            stacked[field.name] = torch.cat(tensors)
    return replace(windows[0], **stacked)


def _ring(ego_SE3_camera: Float64) -> Tensor:
    """Return whether a view attends to another (V, V): to itself, the one before it and the one behind it in the round.

    The round goes by the azimuths of the optical axes, so that it does not depend on the order of the views.
    """
    views = len(ego_SE3_camera)
    azimuth = np.arctan2(ego_SE3_camera[:, 1, 2], ego_SE3_camera[:, 0, 2])
    place = torch.from_numpy(np.argsort(np.argsort(azimuth, kind="stable")))
    step = (place[:, None] - place) % views
    return (step <= 1) | (step == views - 1)


def _batched(matrix: Any) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(matrix, np.float32))[None, None]
