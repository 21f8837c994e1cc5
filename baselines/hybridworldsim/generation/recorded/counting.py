"""Counts what a clip shows, and how far its backgrounds are from its images."""

from __future__ import annotations

import numpy as np

from hybridworldsim.generation.clips.clip import ABSENT, CATEGORIES, Clip
from hybridworldsim.generation.recorded.documents import HIDDEN, SIZES, UNKNOWN, BackgroundError, ClipCounts
from mirror.arrays import AnyArray, Float64
from mirror.errors import DatasetError


def busy_share(tracks: AnyArray, least_share: float) -> float:
    """Return the share of frames of masks (F, V, H, W) in which one road user fills a given share of a view."""
    least = least_share * tracks.shape[-1] * tracks.shape[-2]
    return float(np.mean([any(max(_pixels_of(view).values(), default=0) >= least for view in one) for one in tracks]))


def count_clip(clip: Clip) -> ClipCounts:
    """Count the content of a clip; each road user counts once.

    Raises:
        DatasetError: the clip has no masks.
    """
    if clip.tracks is None:
        raise DatasetError("a clip without masks", place=clip.clip_id, expected="masks of road users")
    classes = dict(zip(clip.boxes.track.tolist(), clip.boxes.category.tolist()))
    area = clip.size_px[0] * clip.size_px[1]
    shown: dict[str, dict[str, int]] = {}
    for view in clip.tracks.reshape(-1, *clip.size_px):
        for track, pixels in _pixels_of(view).items():
            sizes = shown.setdefault(CATEGORIES[classes[track]], {name: 0 for _, name in SIZES})
            sizes[_name(pixels / area, SIZES)] += 1
    seen = np.unique(clip.tracks)
    tracks = [CATEGORIES[classes[track]] for track in seen[seen != ABSENT].tolist()]
    excluded = np.zeros(clip.tracks.shape, np.bool_) if clip.excluded is None else clip.excluded
    return ClipCounts(
        windows=1,
        frames=len(clip),
        seconds=len(clip) / clip.rate_hz,
        tracks={name: tracks.count(name) for name in dict.fromkeys(tracks)},
        shown=shown,
        excluded=float(excluded.mean()),
        masked=float((clip.tracks != ABSENT).mean()),
        errors=_errors(clip, excluded | (clip.tracks != ABSENT)),
    )


def _errors(clip: Clip, masked: AnyArray) -> dict[str, BackgroundError]:
    difference = clip.images.astype(np.float32) - clip.background
    square: Float64 = np.square(difference).mean(axis=-1, dtype=np.float64)[~masked]
    if clip.hidden is None:
        return {UNKNOWN: BackgroundError(pixels=square.size, square=float(square.sum()))}
    hidden = clip.hidden[~masked] / 255.0
    place = np.searchsorted([least for least, _ in HIDDEN], hidden, side="right") - 1
    pixels = np.bincount(place, minlength=len(HIDDEN))
    sums = np.bincount(place, weights=square, minlength=len(HIDDEN))
    return {
        name: BackgroundError(pixels=int(count), square=float(total))
        for (_, name), count, total in zip(HIDDEN, pixels, sums)
    }


def _pixels_of(view: AnyArray) -> dict[int, int]:
    numbers, counts = np.unique(view, return_counts=True)
    return {int(number): int(count) for number, count in zip(numbers, counts) if number != ABSENT}


def _name(share: float, classes: tuple[tuple[float, str], ...]) -> str:
    return [name for least, name in classes if share >= least][-1]
