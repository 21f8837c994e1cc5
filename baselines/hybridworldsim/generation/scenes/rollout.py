"""Generates a long sequence in segments, so that memory is bounded and an interrupted run continues bit for bit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import torch

from hybridworldsim.generation.autoencoder.codec import LatentCodec
from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions, GeneratedFrame, roll_out_clip
from hybridworldsim.generation.layout.boxes import OWN_STYLE, BoxStyle
from hybridworldsim.generation.network.configuration import TransformerConfig
from hybridworldsim.generation.network.transformer import Transformer
from hybridworldsim.generation.scenes.scene_clip import PlannedFrame, SceneConditions, make_scene_clip
from mirror.arrays import UInt8
from mirror.errors import DatasetError, UsageError

SEGMENT: Final = 16
"""Frames of a segment."""


@dataclass(frozen=True, eq=False)
class SceneGenerator:
    """A network with its autoencoder.

    Attributes:
        network: the network.
        codec: the autoencoder, on the same device.
        references: T, number of reference frames.
        style: how layouts are drawn.
        ring: as in `frame_conditions`.
    """

    network: Transformer
    codec: LatentCodec
    references: int
    style: BoxStyle = OWN_STYLE
    ring: bool = False

    def require_size(self, size_px: tuple[int, int]) -> None:
        """Check a height and width of generated images.

        Raises:
            UsageError: the network does not take it.
        """
        require_size(self.network.config, size_px, "choose the size of the training's clips")


def require_size(config: TransformerConfig, size_px: tuple[int, int], remedy: str) -> None:
    """Check a height and width of generated images.

    Raises:
        UsageError: the network does not take it.
    """
    if not config.takes_size(size_px):
        height, width = size_px
        raise UsageError(
            f"images of {width} x {height} px", place="--size", expected=config.sizes, remedy=remedy
        )  # fmt: skip


def require_codec(
    config: TransformerConfig, codec: LatentCodec, file: Path, place: str, expected: str, remedy: str
) -> None:
    """Check that the latents of an autoencoder fit a network.

    Args:
        config: the network.
        codec: the autoencoder.
        file: file or folder of the autoencoder, for errors.
        place: option that names it.
        expected: the right one.
        remedy: how to name it.

    Raises:
        DatasetError: they have other channels or another resolution.
    """
    if (codec.channels, codec.stride) != (config.latent_channels, config.latent_stride):
        raise DatasetError(
            f"latents of {codec.channels} channels and {codec.stride} px, but the generator takes"
            f" {config.latent_channels} channels and {config.latent_stride} px",
            file=file, place=place, expected=expected, remedy=remedy,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class SequenceState:
    """The state of a sequence: the next frame's number, and the latents (1, T, V, C, H, W) before it."""

    frame: int
    latents: torch.Tensor


def roll_out_sequence(
    generator: SceneGenerator,
    frames: Sequence[PlannedFrame],
    scene: SceneConditions,
    options: ClipRolloutOptions,
    *,
    edit: Callable[[Clip, int], Clip] | None = None,
    state: SequenceState | None = None,
    recorded_seeds: bool = True,
) -> Iterator[tuple[GeneratedFrame, SequenceState | None]]:
    """Generate the frames after the first T.

    Args:
        generator: network and autoencoder.
        frames: the sequence; the first T seed it.
        scene: cameras, backgrounds and rate.
        options: how frames are generated.
        edit: changes the boxes of a clip, given it and the number of its first frame; seeds stay as they are.
        state: where an earlier call was after a segment; None: the beginning.
        recorded_seeds: whether recorded images seed the sequence; else their backgrounds do, without boxes.

    Yields:
        Each generated frame, numbered in the sequence, and after the last frame of a segment the state.
    """
    references = generator.references
    if state is not None:
        # A state that was read from a file is on the processor.
        state = replace(state, latents=state.latents.to(next(generator.network.parameters()).device))
    start = references if state is None else state.frame
    # Of the references of a later segment, so that no view is rendered twice.
    rendered: UInt8 | None = None
    while start < len(frames):
        end = min(start + SEGMENT, len(frames))
        first = start - references
        is_start = state is None
        clip = make_scene_clip(
            f"frames {first} to {end - 1}",
            frames[first:end],
            scene,
            recorded=references if is_start and recorded_seeds else 0,
            rendered=rendered,
        )
        rendered = clip.background[-references:]
        if is_start and not recorded_seeds:
            clip = _without_road_users(clip, references)
        edited = None if edit is None else edit(clip, first)
        latest = [] if state is None else list(state.latents.split(1, dim=1))
        rollout = roll_out_clip(
            generator.network,
            generator.codec,
            # The references of a later segment were generated with the edit.
            clip if is_start or edited is None else edited,
            generator.style,
            references,
            references,
            options,
            edited=edited,
            latents=None if state is None else state.latents,
            offset=first,
            captions=scene.captions,
            ring=generator.ring,
        )
        for one in rollout:
            latest = [*latest, one.latents][-references:]
            number = first + one.frame
            frame = GeneratedFrame(number, one.images, one.generated, one.latents)
            if number + 1 < end:
                yield frame, None
            elif len(latest) == references:
                state = SequenceState(end, torch.cat(latest, dim=1))
                yield frame, state
            else:
                # A segment shorter than T ends the sequence.
                yield frame, None
        start = end


def _without_road_users(clip: Clip, count: int) -> Clip:
    """The same clip with the empty street in its first frames: training shows no box without its road user."""
    clip.images[:count] = clip.background[:count]
    return replace(clip, boxes=clip.boxes[clip.boxes.frame >= count])
