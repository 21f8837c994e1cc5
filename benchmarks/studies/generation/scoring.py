"""Scores of a rollout: what the bars of the study are computed from, as arrays for each clip."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Final, TypeAlias

import numpy as np
from torch import nn

from benchmarks.studies.generation.features import DIMENSIONS, Features
from benchmarks.studies.generation.judge_data import CROP_PX, LEAST_PX, crop, judged_boxes
from benchmarks.studies.generation.judges import classify, mask_ious, segment
from hybridworldsim.generation.clips.clip import ABSENT, Clip
from hybridworldsim.generation.inference.clip_rollout import views_with_boxes
from mirror.arrays import AnyArray, Float64, Int64, UInt8

LUMA: Final = np.array([0.299, 0.587, 0.114])

Scores: TypeAlias = Mapping[str, AnyArray]
"""Arrays of one clip, by name; see `score_clip`."""


def score_clip(
    clip: Clip, first: int, images: UInt8, features: Features, judges: tuple[nn.Module, nn.Module] | None
) -> dict[str, AnyArray]:
    """Score the frames of a clip from a first one on.

    Args:
        clip: the clip, with tracks.
        first: number of the first scored frame.
        images: (F - first, V, H, W, 3) generated images; the clip's own and its backgrounds are scored in the same way.
        features: features of images.
        judges: segmenter and classifier; None: nothing is segmented or classified.

    Returns:
        ``image`` (N, D): features of views that show a box. ``motion`` (M, D): differences of features of a view
        between two consecutive frames. ``crop`` (K, D), ``crop_class``, ``crop_found`` (K,): crops of judged boxes.
        ``square``, ``copy``, ``count`` (F - first,): squared errors outside the masks, of the images and of the
        background copied, and numbers of values. ``iou``: masks of views with enough pixels. ``track``, ``frame``,
        ``own``, ``true`` (Q,): mean brightness of a road user in both; ``seen``: whether a seed shows it.
    """
    if clip.tracks is None:
        raise ValueError(f"{clip.clip_id} has no tracks")
    frames = range(first, len(clip))
    shown = np.stack([views_with_boxes(clip, frame) for frame in frames]) & clip.present[first:]
    all_features = np.zeros((*shown.shape, DIMENSIONS))
    all_features[shown] = features(images[shown])
    pairs = shown[1:] & shown[:-1]
    found: dict[str, AnyArray] = {
        "image": all_features[shown],
        "motion": (all_features[1:] - all_features[:-1])[pairs],
    }
    found |= score_background(clip, frames, images, {"copy": clip.background[first:]})
    found |= _score_crops(clip, first, images, features, judges)
    found |= _compare_brightness(clip, first, images)
    if judges is not None:
        masks = (clip.tracks[first:] != ABSENT)[shown]
        found["iou"] = mask_ious(segment(judges[0], images[shown], clip.background[first:][shown]), masks)
    return found


def score_background(
    clip: Clip, frames: Sequence[int], images: UInt8, others: Mapping[str, UInt8]
) -> dict[str, AnyArray]:
    """Return the squared errors outside the masks of road users, in views that show a box.

    Args:
        clip: the clip, with tracks.
        frames: numbers of the scored frames.
        images: (len(frames), V, H, W, 3) generated images.
        others: further images of the same frames, by name.

    Returns:
        ``square``, ``count`` (len(frames),): sums of squared errors of the generated images, and numbers of values; for
        each of the others its squared errors under its name.
    """
    if clip.tracks is None:
        raise ValueError(f"{clip.clip_id} has no tracks")
    rows = list(frames)
    shown = np.stack([views_with_boxes(clip, frame) for frame in rows]) & clip.present[rows]
    outside = (clip.tracks[rows] == ABSENT) & shown[..., None, None]
    found: dict[str, AnyArray] = {"count": 3 * outside.sum(axis=(1, 2, 3))}
    for name, given in {"square": images, **others}.items():
        error = ((given.astype(np.float64) - clip.images[rows]) / 255.0) ** 2
        found[name] = (error * outside[..., None]).sum(axis=(1, 2, 3, 4))
    return found


def outside_db(scores: Sequence[Scores], name: str, frames: slice = slice(None)) -> float:
    """Return the PSNR of all pixels that `score_background` counted, in some of the frames."""
    total, count = (math.fsum(float(one[key][frames].sum()) for one in scores) for key in (name, "count"))
    return -10.0 * math.log10(total / count) if total > 0.0 else math.inf


def background_db(scores: Sequence[Scores]) -> dict[str, float]:
    """Return the PSNR outside the masks, that of the background copied, and how the difference changes to the end.

    ``drift`` is the loss against the copy in the last ten frames, less that in the first ten, in dB.
    """
    start, end = slice(0, 10), slice(-10, None)
    loss = [outside_db(scores, "copy", where) - outside_db(scores, "square", where) for where in (start, end)]
    return {
        "db": outside_db(scores, "square"),
        "copy_db": outside_db(scores, "copy"),
        "drift_db": loss[1] - loss[0],
    }


def identity(scores: Sequence[Scores], long_frames: int, least_tracks: int) -> dict[str, float]:
    """Correlate the brightness of road users with the truth, and state the part that is left at a track's end.

    The end is the last five frames of tracks that are seen over ``long_frames`` frames; if fewer than
    ``least_tracks`` are, over the longest span that as many tracks have. Figures that begin with ``seen_`` are of the
    road users that the seeds show: nothing tells a model the colour of the others.
    """
    names = ("track", "frame", "own", "true")
    seen = [{name: one[name][one["seen"]] for name in names} for one in scores]
    own = _identity(seen, long_frames, least_tracks)
    return _identity(scores, long_frames, least_tracks) | {f"seen_{name}": value for name, value in own.items()}


def _identity(scores: Sequence[Scores], long_frames: int, least_tracks: int) -> dict[str, float]:
    spans = [np.array([np.ptp(one["frame"][one["track"] == track]) + 1 for track in _tracks(one)]) for one in scores]
    sorted_spans = np.sort(np.concatenate([np.zeros(0), *spans]))[::-1]
    longest = sorted_spans[min(least_tracks, len(sorted_spans)) - 1] if len(sorted_spans) else 0
    horizon = int(min(long_frames, longest))
    begun, ended, both = [], [], []
    for one in scores:
        pairs = np.stack([one["own"], one["true"]], axis=1)
        both.append(pairs)
        for track in _tracks(one):
            mine = one["track"] == track
            age = one["frame"][mine] - one["frame"][mine].min()
            if age.max() + 1 >= horizon:
                begun.append(pairs[mine][age < 5])
                ended.append(pairs[mine][(age >= horizon - 5) & (age < horizon)])
    overall, first, last = (_correlate(rows) for rows in (both, begun, ended))
    return {"correlation": overall, "horizon_frames": horizon, "kept": last / first if first > 0 else float("nan")}


def _score_crops(
    clip: Clip, first: int, images: UInt8, features: Features, judges: tuple[nn.Module, nn.Module] | None
) -> dict[str, AnyArray]:
    boxes = [box for box in judged_boxes(clip) if box.frame >= first]
    crops = np.zeros((len(boxes), CROP_PX, CROP_PX, 3), np.uint8)
    for row, box in enumerate(boxes):
        crops[row] = crop(images[box.frame - first, box.view], box.square_px)
    classes = np.array([box.category for box in boxes], np.int64)
    found = classes if judges is None or not len(boxes) else classify(judges[1], crops)
    return {"crop": features(crops), "crop_class": classes, "crop_found": found}


def _compare_brightness(clip: Clip, first: int, images: UInt8) -> dict[str, AnyArray]:
    """Mean luma of each road user with enough pixels, in the images and in the truth."""
    rows: list[tuple[int, int, float, float]] = []
    seen = np.unique(clip.tracks[:first]) if clip.tracks is not None else np.zeros(0, np.int64)
    if clip.tracks is not None:
        for frame in range(first, len(clip)):
            numbers, counts = np.unique(clip.tracks[frame], return_counts=True)
            own, true = images[frame - first] @ LUMA, clip.images[frame] @ LUMA
            for track in numbers[(numbers != ABSENT) & (counts >= LEAST_PX)].tolist():
                mask = clip.tracks[frame] == track
                rows.append((track, frame, float(own[mask].mean()), float(true[mask].mean())))
    columns = list(zip(*rows)) if rows else [(), (), (), ()]
    names = ("track", "frame", "own", "true")
    found: dict[str, AnyArray] = {name: np.array(column, np.float64) for name, column in zip(names, columns)}
    return {**found, "seen": np.isin(found["track"], seen)}


def _tracks(scores: Scores) -> Int64:
    return np.unique(scores["track"])


def _correlate(parts: Sequence[Float64]) -> float:
    pairs: Float64 = np.concatenate([np.zeros((0, 2)), *parts])
    if len(pairs) < 3 or not np.std(pairs[:, 0]) > 0.0 or not np.std(pairs[:, 1]) > 0.0:
        return float("nan")
    return float(np.corrcoef(pairs[:, 0], pairs[:, 1])[0, 1])
