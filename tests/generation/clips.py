"""Small clips of random images, with a moving box."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hybridworldsim.generation.clips.clip import Clip, ClipBoxes
from hybridworldsim.generation.clips.folder import ClipList, write_clip, write_list

FRAMES, VIEWS, HEIGHT, WIDTH = 8, 2, 16, 24


def make_clip(clip_id: str = "clip-0", *, seed: int = 0, frames: int = FRAMES) -> Clip:
    """A clip of smooth random backgrounds; images differ from them where the box is."""
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 256, (frames, VIEWS, HEIGHT // 8, WIDTH // 8, 3), np.uint8)
    background = coarse.repeat(8, axis=2).repeat(8, axis=3)
    images = background.copy()
    images[:, :, 6:10, 8:16] = rng.integers(0, 256, 3, np.uint8)
    tracks = np.full(images.shape[:-1], -1, np.int16)
    tracks[:, :, 6:10, 8:16] = 3
    lens = np.array([[20.0, 0.0, WIDTH / 2], [0.0, 20.0, HEIGHT / 2], [0.0, 0.0, 1.0]])
    mounts = np.tile(np.eye(4), (VIEWS, 1, 1))
    mounts[:, :3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    mounts[:, 1, 3] = np.arange(VIEWS)
    poses, start = np.tile(np.eye(4), (frames, 1, 1)), np.tile(np.eye(4), (frames, 1, 1))
    poses[:, 0, 3], start[:, 0, 3] = 8.0 + np.arange(frames), np.arange(frames)
    number = np.arange(frames, dtype=np.int64)
    boxes = ClipBoxes(
        number, np.full(frames, 3), np.zeros(frames, np.int64), poses, np.tile((4.0, 2.0, 1.5), (frames, 1))
    )
    return Clip(
        clip_id, f"drive-{seed}", 5.0, ("left", "right"), images, background, np.ones((frames, VIEWS), bool),
        np.tile(lens, (VIEWS, 1, 1)), mounts, start, boxes, tracks,
    )  # fmt: skip


def write_clips(folder: Path, count: int = 2) -> Path:
    """A folder of clips for training."""
    clips = [make_clip(f"clip-{seed}", seed=seed) for seed in range(count)]
    for clip in clips:
        write_clip(folder, clip)
    write_list(folder, ClipList(source="test", training=tuple(clip.clip_id for clip in clips), test=()))
    return folder
