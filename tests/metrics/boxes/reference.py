"""Overlaps in space in 60 digits, and an outline to fill."""

from __future__ import annotations

from decimal import Decimal, localcontext

import numpy as np

from mirror.arrays import Float64
from mirror.geometry import Poses

Point = tuple[Decimal, Decimal]
# A car's outline in units of its rectangle: the hull of a projected box, six corners.
CAR = np.array([[0.0, 0.18], [0.31, 0.0], [1.0, 0.07], [0.98, 0.79], [0.62, 1.0], [0.03, 0.86]])


def exact_iou(pose: Poses, lwh: Float64, pose2: Poses, lwh2: Float64) -> float:
    """Two upright boxes in 60 digits: polygon clipping, with the turns that the quaternions stand for."""
    with localcontext(prec=60):
        return _exact_iou(pose, lwh, pose2, lwh2)


def _exact_iou(pose: Poses, lwh: Float64, pose2: Poses, lwh2: Float64) -> float:

    def outline(pose: Poses, size: Float64) -> list[Point]:
        w, z = Decimal(float(pose.rotation[0, 0])), Decimal(float(pose.rotation[0, 3]))
        cos, sin = (w * w - z * z) / (w * w + z * z), 2 * w * z / (w * w + z * z)
        x, y = (Decimal(float(value)) for value in pose.translation[0, :2])
        half = [Decimal(float(side)) / 2 for side in size]
        signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
        return [
            (x + cos * s * half[0] - sin * t * half[1], y + sin * s * half[0] + cos * t * half[1]) for s, t in signs
        ]

    def area(polygon: list[Point]) -> Decimal:
        following = polygon[1:] + polygon[:1]
        return sum((a[0] * b[1] - a[1] * b[0] for a, b in zip(polygon, following)), Decimal(0)) / 2

    def clip(polygon: list[Point], window: list[Point]) -> list[Point]:
        for a, b in zip(window, window[1:] + window[:1]):
            left = [(b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) for p in polygon]
            kept = []
            for index, end in enumerate(polygon):
                start, here, there = polygon[index - 1], left[index - 1], left[index]
                if (here < 0) != (there < 0):
                    share = here / (here - there)
                    kept.append((start[0] + share * (end[0] - start[0]), start[1] + share * (end[1] - start[1])))
                if there >= 0:
                    kept.append(end)
            polygon = kept
        return polygon

    first, second = outline(pose, lwh[0]), outline(pose2, lwh2[0])
    z, z2 = Decimal(float(pose.translation[0, 2])), Decimal(float(pose2.translation[0, 2]))
    h, h2 = Decimal(float(lwh[0, 2])), Decimal(float(lwh2[0, 2]))
    height = max(min(z + h / 2, z2 + h2 / 2) - max(z - h / 2, z2 - h2 / 2), Decimal(0))
    shared = area(clip(first, second)) * height
    return float(shared / (area(first) * h + area(second) * h2 - shared))
