"""The window of a frame: the T frames before it and the frame itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from hybridworldsim.generation.clips.captions import require_equal_lengths
from hybridworldsim.generation.network.conditions import Conditions
from hybridworldsim.generation.network.configuration import TransformerConfig
from mirror.errors import UsageError

REFERENCES = 5
"""T of the paper: number of reference frames."""


def seed_frames(first: int, references: int = REFERENCES) -> range:
    """Return the recorded frames that seed a rollout: they precede its first frame, so that no seed is output.

    For an edited window these frames show the vehicles before the edit begins: a seed within the window would show a
    vehicle where it was before it was moved.

    Args:
        first: number of the first generated frame.
        references: number of reference frames.

    Raises:
        UsageError: fewer frames stand before the first one.
    """
    if first < references:
        raise UsageError(
            f"frame {first} has {first} frames before it", expected=f"{references}, which seed the rollout",
            remedy=f"begin at frame {references} or later, or give a longer window",
        )  # fmt: skip
    return range(first - references, first)


def join_conditions(
    config: TransformerConfig, frames: Sequence[Conditions], origin: Tensor | None = None
) -> Conditions:
    """Return the conditions of a window.

    Args:
        config: the network.
        frames: conditions of one frame each, the target last; `ego_to_first` is in a frame that all share.
        origin: (B, 1, 4, 4) the pose in that frame to which poses are made relative; None: that of the first frame.

    Returns:
        For references as frames: T + 1 frames, with `ego_to_first` relative to the origin. For references as
        channels: the target frame, with the layouts of all frames in its channels, the target's last.

    Raises:
        UsageError: a part is given in some frames only, or captions have different numbers of tokens.
    """
    target = frames[-1]
    if config.reference_channels:
        own = torch.eye(4, dtype=target.ego_to_first.dtype, device=target.ego_to_first.device)
        layouts = [one.layout for one in frames if one.layout is not None]
        return replace(
            target,
            ego_to_first=own.expand_as(target.ego_to_first),
            layout=torch.cat(layouts, dim=3) if layouts else None,
        )

    require_equal_lengths(one.text for one in frames)

    def join(name: str) -> Tensor | None:
        tensors = [getattr(one, name) for one in frames]
        present = [tensor for tensor in tensors if tensor is not None]
        if 0 < len(present) < len(tensors) and name == "present":
            present = [
                torch.ones(one.shape, dtype=torch.bool, device=one.pooled.device) if tensor is None else tensor
                for one, tensor in zip(frames, tensors)
            ]
        elif 0 < len(present) < len(tensors):
            raise UsageError(f"some frames have no {name}", expected="all frames of a window, or none")
        return torch.cat(present, dim=1) if present else None

    joined = {
        name: join(name)
        for name in ("intrinsics", "camera_to_ego", "ego_to_first", "text", "pooled", "layout", "background", "present")
    }
    to_first = joined["ego_to_first"]
    if to_first is not None:
        joined["ego_to_first"] = torch.linalg.inv(to_first[:, :1] if origin is None else origin) @ to_first
    return replace(target, **joined)  # type: ignore[arg-type]


def without_layout(conditions: Conditions, value: float = 0.0) -> Conditions:
    """Return the conditions of a window without boxes and lanes, as training with `drop_layout` uses them.

    Args:
        conditions: of the window.
        value: value of all pixels of a layout that is left out.

    Raises:
        UsageError: the window has no layout.
    """
    if conditions.layout is None:
        raise UsageError("guidance of a network without layout", expected="a network that takes boxes")
    return replace(conditions, layout=torch.full_like(conditions.layout, value))


def join_features(frames: Sequence[list[Tensor]], shape: tuple[int, int]) -> list[Tensor]:
    """Join the adapters' features of single frames.

    Args:
        frames: of each frame, features (B * V, L, width).
        shape: B and V.

    Returns:
        Features (B * T * V, L, width).
    """
    return [
        torch.stack([one.unflatten(0, shape) for one in of_layer], dim=1).flatten(0, 2) for of_layer in zip(*frames)
    ]
