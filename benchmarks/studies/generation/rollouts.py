"""Rollouts over the test clips, one compressed file for each clip; an interrupted run continues with the next clip."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.inference.clip_rollout import ClipRolloutOptions, roll_out_clip
from hybridworldsim.generation.inference.frame_sampler import SamplerSettings
from hybridworldsim.generation.layout.boxes import OWN_STYLE
from hybridworldsim.generation.model_files import read_autoencoder, read_generator
from mirror.arrays import UInt8
from mirror.progress import ProgressReporter
from mirror.schema.files import write_bytes


def shorten(clip: Clip, first: int, last: int) -> Clip:
    """Return the frames of a clip from a first one to before a last one; poses keep their common frame."""
    boxes = clip.boxes
    kept = (boxes.frame >= first) & (boxes.frame < last)
    return replace(
        clip,
        images=clip.images[first:last],
        background=clip.background[first:last],
        present=clip.present[first:last],
        start_SE3_ego=np.linalg.inv(clip.start_SE3_ego[first]) @ clip.start_SE3_ego[first:last],
        boxes=replace(boxes[kept], frame=boxes.frame[kept] - first),
        tracks=None if clip.tracks is None else clip.tracks[first:last],
    )


def predict_next(
    generator: Path, autoencoder: Path, clips: Sequence[Clip], frames: Sequence[int], steps: int
) -> dict[str, UInt8]:
    """Generate single frames of clips, each from the recorded frames before it.

    Args:
        generator: file of the generator.
        autoencoder: file of its autoencoder.
        clips: the clips.
        frames: numbers of the frames, T or higher.
        steps: steps of the sampler.

    Returns:
        Images (len(frames), V, H, W, 3) by clip.
    """
    network, references = read_generator(generator)
    codec = read_autoencoder(autoencoder)
    options = ClipRolloutOptions(SamplerSettings(steps), keep_empty_views=False)
    found = {}
    for clip in clips:
        windows = [shorten(clip, frame - references, frame + 1) for frame in frames]
        made = [
            next(
                roll_out_clip(
                    network, codec, one, OWN_STYLE, references, references, options, offset=frame - references
                )
            )
            for one, frame in zip(windows, frames)
        ]
        found[clip.clip_id] = np.stack([one.images for one in made])
    return found


def roll_out_all(
    generator: Path,
    autoencoder: Path,
    clips: Sequence[Clip],
    out: Path,
    steps: int,
    progress: ProgressReporter,
    *,
    seed: int = 0,
    context_noise: float = 0.0,
) -> dict[str, UInt8]:
    """Generate every frame of clips behind the seeds.

    Args:
        generator: file of the generator.
        autoencoder: file of its autoencoder.
        clips: the clips.
        out: folder of the results.
        steps: steps of the sampler.
        progress: receives each finished clip.
        seed: seed of the noise.
        context_noise: noise level of the references, as in training.

    Returns:
        Images (F - T, V, H, W, 3) by clip.
    """
    network, references = read_generator(generator)
    codec = read_autoencoder(autoencoder)
    options = ClipRolloutOptions(SamplerSettings(steps, context_noise=context_noise), keep_empty_views=False, seed=seed)
    found = {}
    progress.start("rollouts", len(clips))
    for clip in clips:
        path = out / f"{clip.clip_id}.npz"
        if not path.is_file():
            frames = roll_out_clip(network, codec, clip, OWN_STYLE, references, references, options)
            sink = io.BytesIO()
            np.savez_compressed(sink, images=np.stack([frame.images for frame in frames]))
            write_bytes(path, sink.getvalue())
        with np.load(path) as file:
            found[clip.clip_id] = file["images"]
        progress.advance(1)
    return found
