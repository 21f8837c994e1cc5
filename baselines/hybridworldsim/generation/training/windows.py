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
from hybridworldsim.generation.clips.folder import KEEP_BYTES, ClipHeader, headers_of
from hybridworldsim.generation.clips.weights import pixel_weights
from hybridworldsim.generation.inference.windows import join_conditions
from hybridworldsim.generation.layout.boxes import BoxStyle
from hybridworldsim.generation.layout.images import draw_clip_layout, takes_map
from hybridworldsim.generation.layout.map_lines import MAP_CHANNELS
from hybridworldsim.generation.network.conditions import Conditions
from hybridworldsim.generation.network.configuration import TransformerConfig
from hybridworldsim.kept_items import KeptItems
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
        weight: (B, 1, V, H, W) weight of each latent of the target in the loss; None: all count alike.
    """

    target: Tensor
    references: Tensor
    conditions: Conditions
    present: Tensor
    weight: Tensor | None = None

    def to(self, device: torch.device | str) -> WindowBatch:
        """Move the windows to a device."""
        return WindowBatch(
            self.target.to(device), self.references.to(device), self.conditions.to(device), self.present.to(device),
            None if self.weight is None else self.weight.to(device),
        )  # fmt: skip


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


@dataclass(frozen=True, eq=False)
class _PreparedClip:
    """The data that the windows of a clip are cut from.

    Attributes:
        latents: (F, V, C, H, W) of the images.
        layout: (F, V, channels, height, width), in 255ths; None: the network takes none.
        weight: (F, V, H, W) weight of each latent in the loss; None: all count alike.
    """

    latents: Tensor
    layout: UInt8 | None
    weight: Tensor | None

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays."""
        drawn = 0 if self.layout is None else self.layout.nbytes
        return self.latents.nbytes + drawn + (0 if self.weight is None else self.weight.nbytes)


def latent_weights(clip: Clip, stride: int) -> Tensor | None:
    """Return the weights (F, V, H, W) of a clip's latents: means of `pixel_weights`; None if all count equally.

    Args:
        clip: the clip.
        stride: pixels of a latent's side.
    """
    weights = pixel_weights(clip)
    return None if weights is None else torch.nn.functional.avg_pool2d(torch.from_numpy(weights), stride)


class ClipWindows:
    """All windows of some clips; a clip is read, encoded and drawn when one of its windows is first requested.

    Args:
        clips: the clips; all of one rig and size. They may differ in rate: that of a window is an input of the network.
        codec: the autoencoder.
        config: the network.
        style: how boxes are drawn.
        references: T, number of reference frames.
        captions: captions of the views of each frame; None: no text.
        keep_bytes: bytes of latents and layouts that are kept.

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
        keep_bytes: int = KEEP_BYTES,
    ) -> None:
        require_fit(codec, config, style, references)
        headers = headers_of(clips)
        require_clips(headers, config, references)
        self._clips, self._config, self._references, self._captions = clips, config, references, captions
        self._codec, self._style = codec, style
        self._is_weighted = any(one.is_weighted for one in headers)
        self._prepared: KeptItems[int, _PreparedClip] = KeptItems(keep_bytes)
        # The windows of clip n are those from number `starts[n]` on.
        counts = [max(one.frames - references, 0) for one in headers]
        self._starts = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])

    def _clip(self, row: int) -> _PreparedClip:
        return self._prepared.get(row, lambda: self._prepare(self._clips[row]), lambda one: one.nbytes)

    def _prepare(self, clip: Clip) -> _PreparedClip:
        layout = None
        if self._config.layout:
            layout = np.round(draw_clip_layout(clip, self._style, self._config) * 255.0).astype(np.uint8)
        latents = encode_clip(clip, self._codec)
        weight = None
        if self._is_weighted:
            weight = latent_weights(clip, self._codec.stride)
            weight = torch.ones_like(latents[:, :, 0]) if weight is None else weight
        return _PreparedClip(latents, layout, weight)

    def _place(self, number: int) -> tuple[int, int]:
        """The clip of a window, and the frame of its target."""
        if not 0 <= number < len(self):
            raise IndexError(number)
        row = int(np.searchsorted(self._starts, number, side="right")) - 1
        return row, self._references + number - int(self._starts[row])

    def __len__(self) -> int:
        """Number of windows."""
        return int(self._starts[-1])

    def batch(self, numbers: Sequence[int]) -> WindowBatch:
        """Return a batch of the windows with given numbers."""
        places = [self._place(number) for number in numbers]
        targets, references, conditions, present, weights = [], [], [], [], []
        # One after another: the clips of a batch need not fit in what is kept.
        for row, frame in places:
            prepared = self._clip(row)
            targets.append(prepared.latents[frame][None])
            references.append(prepared.latents[frame - self._references : frame])
            weights += [] if prepared.weight is None else [prepared.weight[frame][None]]
            conditions.append(self.conditions(row, frame))
            present.append(torch.from_numpy(self._clips[row].present[frame]))
        return WindowBatch(
            torch.stack(targets),
            torch.stack(references),
            stack_conditions(conditions),
            torch.stack(present)[:, None],
            torch.stack(weights) if weights else None,
        )

    def conditions(self, row: int, frame: int) -> Conditions:
        """Return the conditions of the window that ends with a frame of a clip."""
        singles = [self._frame_conditions(row, one) for one in range(frame - self._references, frame + 1)]
        return join_conditions(self._config, singles)

    def history(self, number: int) -> ClipWindow:
        """Return the frames before the target of a window: at least T, at most 2 T, as many as the clip has."""
        row, frame = self._place(number)
        frames = range(max(frame - 2 * self._references, 0), frame)
        span = slice(frames.start, frames.stop)
        return ClipWindow(
            self._clip(row).latents[span][None],
            [self._frame_conditions(row, one) for one in frames],
            torch.from_numpy(self._clips[row].present[span]),
        )

    def _frame_conditions(self, row: int, frame: int) -> Conditions:
        drawn = self._clip(row).layout
        layout = None if drawn is None else drawn[frame].astype(np.float32) / 255.0
        return frame_conditions(self._clips[row], frame, self._config, layout, self._captions)


def require_clips(
    clips: Sequence[ClipHeader], config: TransformerConfig, references: int, folder: Path | None = None
) -> None:
    """Check that a network can be trained on clips.

    Args:
        clips: headers of at least one clip.
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
    longest = max(clip.frames for clip in clips)
    if longest <= references:
        raise DatasetError(
            f"the longest clip has {longest} frames", file=folder,
            expected=f"at least {references + 1}: {references} references and a target",
            remedy="make longer clips",
        )  # fmt: skip


def require_maps(clips: Sequence[ClipHeader], config: TransformerConfig, style: BoxStyle, folder: Path) -> str | None:
    """Check that at least one clip has a map, if the network takes maps.

    Args:
        clips: headers of the clips.
        config: the network.
        style: how boxes are drawn.
        folder: where the clips are, for errors.

    Returns:
        How many clips have no map, in words; None: all have one, or the network takes none.

    Raises:
        DatasetError: no clip has a map.
    """
    missing = sum(not clip.has_map for clip in clips)
    if not missing or not takes_map(config, style):
        return None
    if missing == len(clips):
        raise DatasetError(
            "no training clip has a map", file=folder, expected="clips with the lines of a map, for a model with --map",
            remedy="make clips of a dataset with a recorded map (`mirror ingest --map`); or train without --map",
        )  # fmt: skip
    return f"{missing} of {len(clips)} training clips have no map: no line is drawn in them"


def _pixels(clip: ClipHeader) -> str:
    height, width = clip.size_px
    return f"{width} x {height} px"


def require_fit(
    codec: LatentCodec, config: TransformerConfig, style: BoxStyle, references: int, file: Path | None = None
) -> None:
    """Check that an autoencoder and a layout fit a network.

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
