"""What a sequence of frames is generated from: cameras, text, layout, background, and which views exist."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor

from hybridworldsim.generation.network.adapter import select_frames
from hybridworldsim.generation.network.mixing_block import KeysValues
from mirror.errors import UsageError


@dataclass(frozen=True, eq=False)
class Conditions:
    """The conditions of B sequences of T frames of V views; B, T and V may be any numbers.

    Attributes:
        size_px: height and width of the images.
        intrinsics: (B, T, V, 3, 3) of images with sides of length 1; see `token_rays`.
        camera_to_ego: (B, T, V, 4, 4) ``ego_SE3_camera`` of each instant.
        ego_to_first: (B, T, 4, 4) ``first_SE3_ego``: the ego frame of each instant in that of the first frame.
        rate_hz: (B,) frames per second.
        text: (B, T, V, M, text_channels) embedded text; M may be 0.
        pooled: (B, T, V, pooled_channels) pooled text; zeros for an empty text.
        layout: (B, T, V, channels, height, width) images of the layout, or None.
        background: (B, T, V, 3, height, width) images of the static street, from 0 to 1, or None.
        present: (B, T, V) which views exist; None: all. Others are neither attended to nor meaningful in the result.
        adjacent: (B, V, V) whether a view (row) attends to another (column); None: all to all.
        view_index: (V,) numbers of the views in the rig; None: 0, 1, 2, ...
    """

    size_px: tuple[int, int]
    intrinsics: Tensor
    camera_to_ego: Tensor
    ego_to_first: Tensor
    rate_hz: Tensor
    text: Tensor
    pooled: Tensor
    layout: Tensor | None = None
    background: Tensor | None = None
    present: Tensor | None = None
    adjacent: Tensor | None = None
    view_index: Tensor | None = None

    @property
    def shape(self) -> tuple[int, int, int]:
        """B, T and V."""
        batch, frames, views = self.intrinsics.shape[:3]
        return batch, frames, views

    def views(self, views: Sequence[int]) -> Conditions:
        """Select the conditions of views, which keep their numbers in the rig."""
        chosen = list(views)
        names = ("intrinsics", "camera_to_ego", "text", "pooled", "layout", "background", "present")
        tensors = {name: getattr(self, name) for name in names}
        chosen_tensors: dict[str, Any] = {
            name: None if tensor is None else tensor[:, :, chosen] for name, tensor in tensors.items()
        }
        if self.adjacent is not None:
            chosen_tensors["adjacent"] = self.adjacent[:, chosen][:, :, chosen]
        index = torch.arange(self.shape[2], device=self.pooled.device) if self.view_index is None else self.view_index
        return replace(self, **chosen_tensors, view_index=index[chosen])

    def to(self, *args: Any) -> Conditions:
        """Convert all floating point tensors and move all tensors, as `torch.Tensor.to` does."""
        moved: dict[str, Any] = {}
        for field in fields(self):
            tensor = getattr(self, field.name)
            if isinstance(tensor, Tensor):
                keeps_type = not tensor.is_floating_point() and isinstance(args[0], torch.dtype)
                moved[field.name] = tensor if keeps_type else tensor.to(*args)
        return replace(self, **moved)

    def require_finite(self) -> None:
        """Check that all numbers are finite.

        Raises:
            UsageError: a tensor is not finite; it is named.
        """
        for field in fields(self):
            tensor = getattr(self, field.name)
            if isinstance(tensor, Tensor) and tensor.is_floating_point() and not bool(tensor.isfinite().all()):
                raise UsageError("numbers that are not finite", place=field.name, expected="finite numbers")


@dataclass(frozen=True, eq=False)
class PreparedConditions:
    """Conditions processed by the network's parts that ignore the latents: computed once, used in every step.

    Attributes:
        shape: B, T and V.
        text: (B * T * V, M, width).
        pooled: (B * T * V, pooled_channels).
        camera: (B * T * V, 1 or rows * columns, width), or None without a camera condition.
        features: features of the adapters, for the first layers; each (B * T * V, rows * columns, width).
        present: as in `Conditions`; None if all views exist.
        adjacent: as in `Conditions`.
        view_index: (V,).
    """

    shape: tuple[int, int, int]
    text: Tensor
    pooled: Tensor
    camera: Tensor | None
    features: list[Tensor]
    present: Tensor | None
    adjacent: Tensor | None
    view_index: Tensor

    def frames(self, frames: slice) -> PreparedConditions:
        """Select the conditions of frames."""
        text, pooled = select_frames([self.text, self.pooled], self.shape, frames)
        count = len(range(self.shape[1])[frames])
        return PreparedConditions(
            (self.shape[0], count, self.shape[2]),
            text,
            pooled,
            None if self.camera is None else select_frames([self.camera], self.shape, frames)[0],
            select_frames(self.features, self.shape, frames),
            None if self.present is None else self.present[:, frames],
            self.adjacent,
            self.view_index,
        )


@dataclass(frozen=True, eq=False)
class ReferenceCache:
    """Keys and values of reference frames in all temporal blocks, for the steps of later frames.

    Attributes:
        frames: number of reference frames.
        layers: by temporal block.
        present: (B, frames, V) which views of them exist; None: all.
        first: place of the first of them in time; that of the frame behind them is ``first + frames``.
    """

    frames: int
    layers: tuple[KeysValues, ...]
    present: Tensor | None
    first: int = 0

    def without_oldest(self) -> ReferenceCache:
        """Return the keys and values of all frames but the first; each frame keeps its place in time."""

        def cut(tensor: Tensor) -> Tensor:
            return tensor[:, :, tensor.shape[2] // self.frames :]

        present = None if self.present is None else self.present[:, 1:]
        layers = tuple(KeysValues(cut(layer.keys), cut(layer.values)) for layer in self.layers)
        return ReferenceCache(self.frames - 1, layers, present, self.first + 1)

    def followed_by(self, later: ReferenceCache) -> ReferenceCache:
        """Append the keys and values of later frames that were computed with these frames as references."""
        layers = tuple(
            KeysValues(*(torch.cat(pair, dim=2) for pair in zip(own, added)))
            for own, added in zip(self.layers, later.layers, strict=True)
        )
        present = self.present if self.present is not None else later.present
        if present is not None:
            known = (torch.ones_like(present[:, :1]).expand(-1, one.frames, -1) for one in (self, later))
            pairs = zip((self.present, later.present), known)
            present = torch.cat([all_exist if one is None else one for one, all_exist in pairs], dim=1)
        return ReferenceCache(self.frames + later.frames, layers, present, self.first)
