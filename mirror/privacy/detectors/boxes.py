"""Boxes of detectors: suppression of duplicates, and tiles of enlarged images."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import cv2
import numpy as np

from mirror.arrays import Bool, Float64, Int64, UInt8
from mirror.privacy.regions import Kind, Region, region_at


def suppress(boxes: Float64, scores: Float64, overlap: float) -> Int64:
    """Return the rows of boxes that no box with a higher score overlaps.

    Args:
        boxes: (N, 4) left, top, right, bottom.
        scores: (N,).
        overlap: largest intersection over union of two kept boxes.

    Returns:
        (K,) rows, by falling score.
    """
    sized = np.concatenate([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]], axis=1)
    kept = cv2.dnn.NMSBoxes(sized.tolist(), scores.tolist(), 0.0, overlap) if len(boxes) else ()
    return np.asarray(kept, np.int64).reshape(-1)


def overlaps(boxes: Float64, others: Float64) -> Float64:
    """Return the intersection over union (N, M) of boxes (N, 4) with boxes (M, 4)."""
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], others[None, :, 2:])
    common: Float64 = np.maximum(high - low, 0.0).prod(axis=2)
    one, other = ((given[:, 2:] - given[:, :2]).prod(axis=1) for given in (boxes, others))
    return common / (one[:, None] + other[None] - common)


def to_regions(boxes: Float64, scores: Float64, kind: Kind, source: str, size_px: tuple[int, int]) -> list[Region]:
    """Return the regions of boxes (N, 4) within a raster of width and height, without boxes outside the raster."""
    limits = np.array([*size_px, *size_px], np.float64)
    clipped = np.clip(np.nan_to_num(boxes, nan=-1.0), 0.0, limits)
    sound = np.isfinite(boxes).all(axis=1) & (clipped[:, 2:] > clipped[:, :2]).all(axis=1)
    return [
        region_at(box, kind, score=min(max(float(score), 0.0), 1.0), source=source)
        for box, score in zip(clipped[sound], scores[sound])
    ]


def tiles(
    width_px: int, height_px: int, tile_px: int, overlap_px: int, skipped: Bool | None = None
) -> Iterator[tuple[tuple[int, int, int, int], bool]]:
    """Yield the tiles that cover a raster, each with whether a detector has to search it.

    Args:
        width_px: width of the raster.
        height_px: height of the raster.
        tile_px: largest side of a tile.
        overlap_px: overlap of neighbours; what is smaller lies wholly in one tile.
        skipped: (H, W) pixels that need no detection; a tile in which all pixels are such is not needed.

    Yields:
        Left, top, right and bottom of a tile, and whether it is needed.
    """
    for top, bottom in _spans(height_px, tile_px, overlap_px):
        for left, right in _spans(width_px, tile_px, overlap_px):
            is_needed = skipped is None or not skipped[top:bottom, left:right].all()
            yield (left, top, right, bottom), is_needed


def detect_in_tiles(
    find: Callable[[UInt8], tuple[Float64, Float64]],
    image: UInt8,
    *,
    scale: float,
    tile_px: int,
    overlap_px: int,
    skipped: Bool | None = None,
) -> tuple[Float64, Float64, int]:
    """Run a detector on enlarged tiles of an image.

    Args:
        find: detects in an image (H, W, 3); returns boxes (N, 4) and scores (N,).
        image: (H, W, 3).
        scale: enlargement of a tile.
        tile_px: side of a tile, in pixels of the image.
        overlap_px: overlap of tiles.
        skipped: as in `tiles`.

    Returns:
        Boxes (N, 4) in the image, scores (N,), and the number of tiles that were skipped.
    """
    boxes, scores, left_out = [np.zeros((0, 4))], [np.zeros(0)], 0
    for (left, top, right, bottom), is_needed in tiles(image.shape[1], image.shape[0], tile_px, overlap_px, skipped):
        if not is_needed:
            left_out += 1
            continue
        size = (round((right - left) * scale), round((bottom - top) * scale))
        part = cv2.resize(image[top:bottom, left:right], size, interpolation=cv2.INTER_CUBIC)
        found, score = find(np.asarray(part, np.uint8))
        boxes.append(found / scale + np.array([left, top, left, top], np.float64))
        scores.append(score)
    return np.concatenate(boxes), np.concatenate(scores), left_out


def _spans(size: int, tile: int, overlap: int) -> list[tuple[int, int]]:
    """Intervals of equal length that cover 0 to size, each at most a tile long."""
    if size <= tile:
        return [(0, size)]
    count = -(-(size - overlap) // (tile - overlap))
    starts = np.rint(np.linspace(0, size - tile, count)).astype(int).tolist()
    return [(start, start + tile) for start in starts]
