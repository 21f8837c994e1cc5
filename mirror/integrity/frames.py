"""The assignment of a scene's images to frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mirror.arrays import Bool, Float64, Int64
from mirror.integrity.rows import TableRows


@dataclass(frozen=True)
class FrameAssignment:
    """The assignment of the N recorded images to frames, and of frames to traversals.

    Attributes:
        is_reference: (N,) True for images of the rig's reference camera.
        framed: (N,) True for images in a frame with an image of the reference camera.
        reference_ns: (N,) timestamp of that image; 0 where there is none.
        has_reference: (traversals,) True where the reference camera has images.
        period_s: (traversals,) period of the reference camera; infinite with fewer than two images.
    """

    is_reference: Bool
    framed: Bool
    reference_ns: Int64
    has_reference: Bool
    period_s: Float64


def assign_frames(images: TableRows, reference_cameras: Sequence[str | None]) -> FrameAssignment:
    """Assign recorded images to frames by the column ``frame_index``.

    Args:
        images: images of the scene, one file for each traversal.
        reference_cameras: reference camera of each traversal's rig; None: no rig.
    """
    codes, words = images.text_codes("camera")
    position = {word: code for code, word in enumerate(words)}
    reference = [-1 if name is None else position.get(name, -1) for name in reference_cameras]
    is_reference = (codes == np.array(reference, np.int64)[images.traversal]) & (codes >= 0)
    known, index, stamps = (
        images.is_known("frame_index"),
        images.integers("frame_index"),
        images.integers("timestamp_ns"),
    )

    lowest = index.min(initial=0)
    key = images.traversal * (index.max(initial=0) - lowest + 1) + index - lowest
    rows = np.flatnonzero(is_reference & known)
    order = rows[np.argsort(key[rows], kind="stable")]
    place = np.searchsorted(key[order], key)
    found = np.zeros(len(images), np.bool_)
    reference_ns = np.zeros(len(images), np.int64)
    if len(order):
        hit = np.minimum(place, len(order) - 1)
        found = known & (key[order][hit] == key)
        reference_ns = np.where(found, stamps[order[hit]], 0)

    period_s = np.full(len(reference_cameras), np.inf)
    has_reference = np.zeros(len(reference_cameras), np.bool_)
    for _, number, own in images.slices():
        shots = stamps[own][is_reference[own]]
        has_reference[number] = len(shots) > 0
        if len(shots) > 1:
            period_s[number] = np.median(np.diff(shots)) * 1e-9
    return FrameAssignment(is_reference, found, reference_ns, has_reference, period_s)
