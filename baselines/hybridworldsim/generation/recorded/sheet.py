"""A sheet of clips to look at: images, backgrounds, and the difference of both."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

import cv2
import numpy as np

from hybridworldsim.generation.clips.clip import ABSENT, Clip
from hybridworldsim.generation.clips.folder import read_clip
from mirror.arrays import UInt8
from mirror.schema.files import write_bytes

SHEET: Final = "sheet.png"
_CLIPS: Final = 6
_SCALE: Final = 2
_GAIN: Final = 2
_GAP_PX: Final = 6
_ROAD_USER: Final = np.array((150, 40, 40))
_EXCLUDED: Final = np.array((40, 40, 150))


def write_sheet(folder: Path, clip_ids: Sequence[str]) -> Path:
    """Write the overview sheet of a folder of clips; returns the sheet's file.

    Three rows for each of six clips, evenly chosen: the images of all views at the middle frame; their backgrounds;
    and twice the absolute difference, where road users are red and excluded pixels blue.
    """
    chosen = np.unique(np.linspace(0, len(clip_ids) - 1, _CLIPS).round().astype(int)).tolist()
    parts = [draw_clip(read_clip(folder, clip_ids[number])) for number in chosen]
    gap = np.full((_GAP_PX, parts[0].shape[1], 3), 255, np.uint8)
    stacked = np.concatenate([piece for part in parts for piece in (part, gap)][:-1])
    sheet = stacked.repeat(_SCALE, axis=0).repeat(_SCALE, axis=1)
    path = folder / SHEET
    write_bytes(path, cv2.imencode(".png", sheet[..., ::-1])[1].tobytes())
    return path


def draw_clip(clip: Clip) -> UInt8:
    """Draw the three rows of a clip: (3 H, V W, 3)."""
    frame = len(clip) // 2
    images, background = clip.images[frame], clip.background[frame]
    difference = np.minimum(_GAIN * np.abs(images.astype(np.int64) - background), 255)
    if clip.tracks is not None:
        difference[clip.tracks[frame] != ABSENT] = _ROAD_USER
    if clip.excluded is not None:
        difference[clip.excluded[frame]] = _EXCLUDED
    rows = [np.concatenate(list(row), axis=1) for row in (images, background, difference.astype(np.uint8))]
    return np.concatenate(rows)
