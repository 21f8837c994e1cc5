"""Training windows: latents and conditions of a target frame and of the frames before it, drawn from clips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from hybridworldsim.generation.autoencoder.codec import LatentCodec, to_tensor
from hybridworldsim.generation.clips.captions import Captions
from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.clips.conditions import frame_conditions, stack_conditions
from hybridworldsim.generation.inference.windows import join_conditions
from hybridworldsim.generation.layout.boxes import BoxStyle
from hybridworldsim.generation.layout.images import draw_clip_layout, takes_map
from hybridworldsim.generation.layout.map_lines import MAP_CHANNELS
from hybridworldsim.generation.network.conditions import Conditions
from hybridworldsim.generation.network.configuration import TransformerConfig
from mirror.arrays import UInt8
from mirror.errors import DatasetError, UsageError


@dataclass(frozen=True, eq=False)
class WindowBatch:
    """A batch of B windows.

    Attributes:
        target: (B, 1, V, C, H, W) clean latents.
        references: (B, T, V, C, H, W) clean latents.
        conditions: from `join_conditions`.
        present: (B, 1, V) which views of the target exist.
    """

    target: Tensor
    references: Tensor
    conditions: Conditions
    present: Tensor


@dataclass(frozen=True, eq=False)
class ClipWindow:
    """F consecutive frames of a clip.

    Attributes:
        latents: (1, F, V, C, H, W) clean latents.
        conditions: of each frame on its own.
        present: (F, V) which views exist.
    """

    latents: Tensor
    conditions: list[Conditions]
    present: Tensor

    def to(self, device: torch.device | str) -> ClipWindow:
        """Move the frames to a device."""
        return ClipWindow(self.latents.to(device), [one.to(device) for one in self.conditions], self.present)


@torch.no_grad()
def encode_clip(clip: Clip, codec: LatentCodec) -> Tensor:
    """Return the latents of a clip's images: (F, V, C, H, W), float32."""
    return torch.stack([codec.encode(to_tensor(frame)) for frame in clip.images])


class ClipWindows:
    """All windows of some clips.

    Args:
        clips: the clips; all of one rig and size. They may differ in rate: that of a window is an input of the network.
        codec: the autoencoder.
        config: the network.
        style: how boxes are drawn.
        references: T, number of reference frames.
        captions: captions of the views of each frame; None: no text.

    Raises:
        DatasetError: as `require_clips`.
        UsageError: the autoencoder or the layout does not fit the network.
    """

    def __init__(
        self,
        clips: Sequence[Clip],
        codec: LatentCodec,
        config: TransformerConfig,
        style: BoxStyle,
        references: int,
        captions: Captions | None = None,
    ) -> None:
        require_fit(codec, config, style, references)
        require_clips(clips, config, references)
        self._clips, self._config, self._references, self._captions = clips, config, references, captions
        self._latents = [encode_clip(clip, codec) for clip in clips]
        self._layouts: list[UInt8] = [
            np.round(draw_clip_layout(clip, style, config) * 255.0).astype(np.uint8) for clip in clips if config.layout
        ]
        self._places = [(row, frame) for row, clip in enumerate(clips) for frame in range(references, len(clip))]

    def __len__(self) -> int:
        """Number of windows."""
        return len(self._places)

    def batch(self, numbers: Sequence[int]) -> WindowBatch:
        """Return the windows of these numbers."""
        places = [self._places[number] for number in numbers]
        windows = [slice(frame - self._references, frame) for _, frame in places]
        conditions = stack_conditions([self.conditions(row, frame) for row, frame in places])
        present = [torch.from_numpy(self._clips[row].present[frame]) for row, frame in places]
        return WindowBatch(
            torch.stack([self._latents[row][frame][None] for row, frame in places]),
            torch.stack([self._latents[row][window] for (row, _), window in zip(places, windows)]),
            conditions,
            torch.stack(present)[:, None],
        )

    def conditions(self, row: int, frame: int) -> Conditions:
        """Return the conditions of the window that ends with a frame of a clip."""
        singles = [self._frame_conditions(row, one) for one in range(frame - self._references, frame + 1)]
        return join_conditions(self._config, singles)

    def history(self, number: int) -> ClipWindow:
        """Return the frames before the target of a window: up to 2 T of them, as many as its clip has; at least T."""
        row, frame = self._places[number]
        frames = range(max(frame - 2 * self._references, 0), frame)
        span = slice(frames.start, frames.stop)
        return ClipWindow(
            self._latents[row][span][None],
            [self._frame_conditions(row, one) for one in frames],
            torch.from_numpy(self._clips[row].present[span]),
        )

    def _frame_conditions(self, row: int, frame: int) -> Conditions:
        layout = self._layouts[row][frame].astype(np.float32) / 255.0 if self._layouts else None
        return frame_conditions(self._clips[row], frame, self._config, layout, self._captions)


def require_clips(
    clips: Sequence[Clip], config: TransformerConfig, references: int, folder: Path | None = None
) -> None:
    """Check that a network can be trained on clips.

    Args:
        clips: at least one clip.
        config: the network.
        references: T, number of reference frames.
        folder: where the clips are, for errors.

    Raises:
        DatasetError: clips differ in rig or size, their images are not whole tokens, or no clip is longer than T.
    """
    first = clips[0]
    if not config.takes_size(first.size_px):
        raise DatasetError(
            f"images of {_pixels(first)}", file=folder, place=first.clip_id, expected=config.sizes,
            remedy="make the clips again in another size",
        )  # fmt: skip
    for clip in clips:
        if (clip.size_px, clip.views) != (first.size_px, first.views):
            raise DatasetError(
                f"views {', '.join(clip.views)} of {_pixels(clip)}", file=folder, place=clip.clip_id,
                expected=f"those of {first.clip_id}: {', '.join(first.views)} of {_pixels(first)}",
                remedy="train on clips of one rig and size",
            )  # fmt: skip
    longest = max(map(len, clips))
    if longest <= references:
        raise DatasetError(
            f"the longest clip has {longest} frames", file=folder,
            expected=f"at least {references + 1}: {references} references and a target",
            remedy="make longer clips",
        )  # fmt: skip


def require_maps(clips: Sequence[Clip], config: TransformerConfig, style: BoxStyle, folder: Path) -> str | None:
    """Check that some clip has a map, if the network takes one.

    Args:
        clips: the clips.
        config: the network.
        style: how boxes are drawn.
        folder: where the clips are, for errors.

    Returns:
        How many clips have no map, in words; None: all have one, or the network takes none.

    Raises:
        DatasetError: no clip has a map.
    """
    missing = sum(clip.lines is None for clip in clips)
    if not missing or not takes_map(config, style):
        return None
    if missing == len(clips):
        raise DatasetError(
            "no training clip has a map", file=folder, expected="clips with the lines of a map, for a model with --map",
            remedy="make clips with maps: python -m benchmarks generation clips --map; or train without --map",
        )  # fmt: skip
    return f"{missing} of {len(clips)} training clips have no map: no line is drawn in them"


def _pixels(clip: Clip) -> str:
    height, width = clip.size_px
    return f"{width} x {height} px"


def require_fit(
    codec: LatentCodec, config: TransformerConfig, style: BoxStyle, references: int, file: Path | None = None
) -> None:
    """Check that an autoencoder and a layout belong to a network.

    Args:
        codec: the autoencoder.
        config: the network.
        style: how boxes are drawn.
        references: T, number of reference frames.
        file: file of the autoencoder, for errors.

    Raises:
        UsageError: they have other channels or another resolution.
    """
    if (codec.channels, codec.stride) != (config.latent_channels, config.latent_stride):
        raise UsageError(
            f"an autoencoder with {codec.channels} channels and stride {codec.stride}",
            file=file,
            place="--autoencoder",
            expected=f"{config.latent_channels} channels and stride {config.latent_stride}, as the network",
            remedy="name the autoencoder that belongs to the generator, or leave it out where one is trained",
        )
    if config.reference_channels not in (0, references * config.latent_channels):
        raise UsageError(
            f"{references} references for a network with {config.reference_channels} further channels",
            expected=f"{config.reference_channels // config.latent_channels} references",
        )
    frames = config.layout_frames
    wanted = [frames * channels for channels in (style.channels, style.channels + MAP_CHANNELS)]
    if config.layout is not None and config.layout.channels not in wanted:
        raise UsageError(
            f"layouts of {frames} x {style.channels} channels, or of {MAP_CHANNELS} more with a map",
            expected=f"{config.layout.channels} channels, as the network",
        )
