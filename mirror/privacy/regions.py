"""Regions of images that show a face or a number plate, and how far some regions cover others."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, Literal

import numpy as np
from pydantic import Field, model_validator

from mirror.arrays import Bool, Float64
from mirror.schema.documents import Document

Kind = Literal["face", "plate"]
KINDS: Final[tuple[Kind, ...]] = ("face", "plate")
Origin = Literal["detector", "track", "camera", "vehicle", "repeat", "reviewer"]


class Region(Document):
    """A rectangle of an image that identifies a person or a vehicle.

    Attributes:
        kind: what it shows.
        left_px: left edge in the stored raster; the first pixel reaches from 0 to 1.
        top_px: upper edge.
        right_px: right edge.
        bottom_px: lower edge.
        score: confidence of the detector, 0 to 1.
        source: name of the detector that found it, or that it was derived from.
        origin: `detector`, or the step that added it: along a `track`, from another `camera`, from the geometry of a
            `vehicle`, by a detector's `repeat` on the redacted image, or by a `reviewer`.
    """

    kind: Kind
    left_px: float
    top_px: float
    right_px: float
    bottom_px: float
    score: float = Field(default=1.0, ge=0.0, le=1.0)
    source: str = ""
    origin: Origin = "detector"

    @model_validator(mode="after")
    def _extent(self) -> Region:
        edges = (self.left_px, self.top_px, self.right_px, self.bottom_px)
        if not np.isfinite(edges).all() or self.right_px <= self.left_px or self.bottom_px <= self.top_px:
            raise ValueError(f"a region from {edges[:2]} to {edges[2:]}")
        return self

    @property
    def box_px(self) -> tuple[float, float, float, float]:
        """Left, top, right and bottom."""
        return self.left_px, self.top_px, self.right_px, self.bottom_px

    @property
    def size_px(self) -> tuple[float, float]:
        """Width and height."""
        return self.right_px - self.left_px, self.bottom_px - self.top_px

    @property
    def centre_px(self) -> tuple[float, float]:
        """Middle of the rectangle."""
        return 0.5 * (self.left_px + self.right_px), 0.5 * (self.top_px + self.bottom_px)

    def moved_to(self, box_px: Sequence[float], origin: Origin, *, score: float | None = None) -> Region:
        """Return the region of the same object at another place."""
        edges = dict(zip(("left_px", "top_px", "right_px", "bottom_px"), map(float, box_px)))
        given = self.score if score is None else score
        return Region(kind=self.kind, **edges, score=given, source=self.source, origin=origin)


def region_at(box_px: Sequence[float], kind: Kind, *, score: float = 1.0, source: str = "") -> Region:
    """Make a region from left, top, right and bottom."""
    left, top, right, bottom = map(float, box_px)
    return Region(
        kind=kind, left_px=left, top_px=top, right_px=right, bottom_px=bottom, score=float(score), source=source
    )


def grown_box(region: Region, share: float, width_px: int, height_px: int) -> tuple[int, int, int, int] | None:
    """Enlarge a region by a share of its size, half on each side, to whole pixels within the raster.

    Returns:
        Left, top, right and bottom; None: the region lies outside the raster.
    """
    (u, v), (width, height) = region.centre_px, region.size_px
    half_u, half_v = 0.5 * width * (1.0 + share), 0.5 * height * (1.0 + share)
    left, top = max(int(np.floor(u - half_u)), 0), max(int(np.floor(v - half_v)), 0)
    right, bottom = min(int(np.ceil(u + half_u)), width_px), min(int(np.ceil(v + half_v)), height_px)
    return (left, top, right, bottom) if right > left and bottom > top else None


def region_mask(regions: Iterable[Region], grow: float, width_px: int, height_px: int) -> Bool:
    """Mark the pixels (H, W) that lie in one of the enlarged regions."""
    mask = np.zeros((height_px, width_px), np.bool_)
    for region in regions:
        box = grown_box(region, grow, width_px, height_px)
        if box is not None:
            mask[box[1] : box[3], box[0] : box[2]] = True
    return mask


def covered_share(box_px: Sequence[float], others: Sequence[Sequence[float]]) -> float:
    """Return the exact share, 0 to 1, of a rectangle that the union of other rectangles covers.

    Args:
        box_px: left, top, right and bottom.
        others: (N, 4) rectangles.
    """
    left, top, right, bottom = box_px
    area = (right - left) * (bottom - top)
    given: Float64 = np.asarray(others, np.float64).reshape(-1, 4)
    if not len(given) or area <= 0.0:
        return 0.0
    u = np.unique(np.clip(np.concatenate([given[:, 0], given[:, 2]]), left, right))
    v = np.unique(np.clip(np.concatenate([given[:, 1], given[:, 3]]), top, bottom))
    middle_u, middle_v = 0.5 * (u[1:] + u[:-1]), 0.5 * (v[1:] + v[:-1])
    across = (given[:, 0, None] <= middle_u) & (middle_u <= given[:, 2, None])
    down = (given[:, 1, None] <= middle_v) & (middle_v <= given[:, 3, None])
    inside = (down.astype(np.int64).T @ across.astype(np.int64)) > 0
    return float((inside * np.diff(v)[:, None] * np.diff(u)[None]).sum() / area)


def merged(regions: Iterable[Region], overlap: float = 0.9) -> list[Region]:
    """Return the regions without those that a region of the same kind with a higher score covers.

    The highest score comes first.

    Args:
        regions: of one image; those of several detectors are joined.
        overlap: the covered share from which a region adds nothing.
    """
    kept: list[Region] = []
    ordered = sorted(regions, key=lambda one: (-one.score, one.kind, one.box_px, one.source))
    for region in ordered:
        if all(other.kind != region.kind or covered_share(region.box_px, [other.box_px]) < overlap for other in kept):
            kept.append(region)
    return kept
