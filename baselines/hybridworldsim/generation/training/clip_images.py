"""All images and backgrounds of clips as one array of images, of which only the rows asked for are read."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybridworldsim.generation.clips.clip import Clip
from hybridworldsim.generation.clips.folder import headers_of
from mirror.arrays import Int64, UInt8


class ClipImages:
    """The images of each clip, frame by frame and view by view, then its backgrounds; clip after clip.

    Args:
        clips: clips of one size.
    """

    def __init__(self, clips: Sequence[Clip]) -> None:
        self._clips = clips
        counts = [2 * one.frames * len(one.views) for one in headers_of(clips)]
        self._starts = np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])

    def __len__(self) -> int:
        """Number of images."""
        return int(self._starts[-1])

    def __getitem__(self, rows: Int64 | slice) -> UInt8:
        """Return the images (N, H, W, 3) of some rows, or of a slice of them."""
        numbers = np.arange(*rows.indices(len(self))) if isinstance(rows, slice) else rows
        return np.stack([self._image(int(number)) for number in numbers])

    def _image(self, number: int) -> UInt8:
        row = int(np.searchsorted(self._starts, number, side="right")) - 1
        clip, place = self._clips[row], number - int(self._starts[row])
        views = clip.present.size
        source = clip.images if place < views else clip.background
        image: UInt8 = source[divmod(place % views, len(clip.views))]
        return image
