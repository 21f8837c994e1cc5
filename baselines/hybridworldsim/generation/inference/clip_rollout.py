"""Rollouts over a clip: images of the empty street and boxes become images with traffic."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import torch

from hybridworldsim.generation.autoencoder.codec import LatentCodec, to_bytes, to_tensor
from hybridworldsim.generation.clips.captions import Captions
from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.clips.conditions import frame_conditions
from hybridworldsim.generation.devices import require_seed
from hybridworldsim.generation.inference.blending import blend, draw_hulls, hull_shares
from hybridworldsim.generation.inference.frame_sampler import SamplerSettings
from hybridworldsim.generation.inference.rollout import SequenceRollout
from hybridworldsim.generation.inference.windows import seed_frames
from hybridworldsim.generation.layout.boxes import BoxStyle
from hybridworldsim.generation.layout.images import draw_frame_layout
from hybridworldsim.generation.network.conditions import Conditions
from hybridworldsim.generation.network.transformer import Transformer
from mirror.arrays import Bool, UInt8
from mirror.errors import UsageError


@dataclass(frozen=True)
class ClipRolloutOptions:
    """Settings of a rollout over a clip: sampler, seed, and how generated and empty views are blended.

    Attributes:
        sampler: how a frame is sampled.
        keep_empty_views: whether a view without a box keeps its background, and a frame without boxes costs nothing.
        blend_px: a generated image is used only within the hulls of boxes, grown by this many pixels, and fades over as
            many behind them; None: it is used everywhere.
        seed: seed of the noise.
    """

    sampler: SamplerSettings = field(default_factory=SamplerSettings)
    keep_empty_views: bool = True
    blend_px: int | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.blend_px is not None and self.blend_px < 0:
            raise UsageError(f"hulls grown by {self.blend_px} px", place="--blend", expected="0 or more")
        require_seed(self.seed)


@dataclass(frozen=True, eq=False)
class GeneratedFrame:
    """One generated frame of a rollout.

    Attributes:
        frame: number of the frame in the clip.
        images: (V, H, W, 3).
        generated: (V,) which views the network generated; the others are their background.
        latents: (1, 1, V, C, H, W) of the images, with which a later rollout continues.
    """

    frame: int
    images: UInt8
    generated: Bool
    latents: torch.Tensor


def roll_out_clip(
    network: Transformer,
    codec: LatentCodec,
    clip: Clip,
    style: BoxStyle,
    first: int,
    references: int,
    options: ClipRolloutOptions,
    *,
    edited: Clip | None = None,
    latents: torch.Tensor | None = None,
    offset: int = 0,
    captions: Captions | None = None,
    ring: bool = False,
) -> Iterator[GeneratedFrame]:
    """Generate the frames of a clip one by one, from a first frame on.

    Args:
        network: the network; the rollout runs on its device.
        codec: the autoencoder, on the same device.
        clip: recorded images seed the rollout; later ones are not read. Backgrounds and boxes of all frames are read,
            and lines of the map, if the network takes one.
        style: how boxes are drawn.
        first: first generated frame; the `references` frames before it seed the rollout.
        references: T, number of reference frames.
        options: see `ClipRolloutOptions`.
        edited: the same clip with other boxes, which hold from the first generated frame on; None: those of the clip.
        latents: (1, T, V, C, H, W) of the references, from an earlier rollout over the frames before; None: those of
            the recorded images.
        offset: number of the clip's first frame in a longer sequence; the noise of a frame depends on its number there.
        captions: captions of the views of each frame; None: no text.
        ring: as in `frame_conditions`.

    Raises:
        UsageError: fewer than T frames stand before the first one, or a part does not fit the network.
    """
    seeds = seed_frames(first, references)
    device = next(network.parameters()).device

    def conditions_of(source: Clip, frame: int) -> Conditions:
        layout = draw_frame_layout(source, frame, style, network.config)
        return frame_conditions(source, frame, network.config, layout, captions, ring=ring).to(device)

    conditions = [conditions_of(clip, frame) for frame in seeds]
    if latents is None:
        latents = torch.stack([_encode(codec, clip.images[frame], device) for frame in seeds])[None]
    latents = latents.to(device)
    rollout = SequenceRollout(
        network,
        latents,
        conditions,
        options.sampler,
        seed=options.seed,
        first=first + offset,
        dropped_layout=style.dropped,
    )
    source = clip if edited is None else edited
    for frame in range(first, len(clip)):
        generated = views_with_boxes(source, frame) if options.keep_empty_views else np.ones(len(clip.views), bool)
        generated &= clip.present[frame]
        kept = None if generated.all() else _encode(codec, clip.background[frame], device)[None, None]
        result = rollout.step(conditions_of(source, frame), active=np.flatnonzero(generated).tolist(), kept=kept)
        images = clip.background[frame].copy()
        if generated.any():
            with torch.no_grad():
                images[generated] = to_bytes(codec.decode(result[0, 0, torch.from_numpy(generated).to(device)]))
        if options.blend_px is not None:
            images = blend(images, clip.background[frame], hull_shares(clip_hulls(source, frame), options.blend_px))
        yield GeneratedFrame(frame, images, generated, result)


def views_with_boxes(clip: Clip, frame: int) -> Bool:
    """Mark the views (V,) of a frame that show at least one box."""
    return np.asarray(clip_hulls(clip, frame).any(axis=(1, 2)))


def clip_hulls(clip: Clip, frame: int) -> Bool:
    """Mark the pixels (H, W) of each view of a frame that show the inside of at least one box."""
    return draw_hulls(clip.boxes.at(frame), clip.intrinsics, clip.cameras_at(frame), clip.size_px)


@torch.no_grad()
def _encode(codec: LatentCodec, images: UInt8, device: torch.device) -> torch.Tensor:
    return codec.encode(to_tensor(images).to(device))
