"""The blocks of a scene: squares of 100 m that overlap by a quarter, each with an origin of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.errors import UsageError

if TYPE_CHECKING:
    from mirror.protocols.views.view import RenderView

SIZE_M: Final = 100.0
OVERLAP: Final = 0.25
REACH_M: Final = 25.0


@dataclass(frozen=True)
class Block:
    """A square of the world's east-north plane, with all that stands on it.

    The block's frame is the world's, moved: ``block = world - origin_m``, subtracted in float64.

    Attributes:
        index: column and row in the scene's grid.
        origin_m: (x, y, z) of the centre in the world, on the ground.
        size_m: of an edge.
        overlap_m: by how much neighbours lie on each other.
    """

    index: tuple[int, int]
    origin_m: tuple[float, float, float]
    size_m: float = SIZE_M
    overlap_m: float = OVERLAP * SIZE_M

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"block_{self.index[0]:02d}_{self.index[1]:02d}"

    @property
    def half_extent_m(self) -> float:
        """How far from its centre, along either axis, a block holds geometry of its own: an overlap beyond its edge."""
        return self.size_m / 2.0 + self.overlap_m

    def local(self, points_m: Float64) -> Float64:
        """Points (N, 3) of the world in the block's frame."""
        return np.asarray(points_m, np.float64) - np.array(self.origin_m)

    def distance_m(self, points_m: Float64) -> Float64:
        """(N,) how far points (N, 2 or more) of the world are from its square: 0 within."""
        beyond = np.abs(np.asarray(points_m, np.float64)[:, :2] - np.array(self.origin_m[:2])) - self.size_m / 2.0
        return np.hypot(*np.maximum(beyond, 0.0).T)

    def far(self, points_m: Float64) -> Bool:
        """(N,) which points (N, 3) of the world stand so far outside that the block's sky takes them in."""
        beyond = np.abs(np.asarray(points_m, np.float64)[:, :2] - np.array(self.origin_m[:2]))
        return np.asarray((beyond > self.half_extent_m).any(axis=1))


@dataclass(frozen=True)
class Division:
    """A scene in blocks.

    Attributes:
        blocks: those where somebody drove, by column, then row.
        skipped: how many others the grid has.
    """

    blocks: tuple[Block, ...]
    skipped: int


def divide(driven_m: Float64, size_m: float = SIZE_M, overlap: float = OVERLAP) -> Division:
    """Divide what was driven into blocks; the same whatever the order of the places.

    The grid lies centrally on the driven places, and has no more columns and rows than they need. A block is kept if
    somebody drove in the part of it that is nearer to its centre than to any other.

    Args:
        driven_m: (N, 3) places of vehicles on the ground, in the world.
        size_m: of a block's edge.
        overlap: of neighbours, as a share of the edge.

    Raises:
        UsageError: there is no place, or one that is not finite; no such size or overlap.
    """
    driven = np.asarray(driven_m, np.float64)
    if not size_m > 0.0 or not 0.0 <= overlap <= 0.5:
        raise UsageError(f"blocks of {size_m:g} m that overlap by {overlap:g}", expected="a size, and 0 to 0.5 of it")
    if driven.ndim != 2 or driven.shape[1] != 3 or not len(driven) or not np.isfinite(driven).all():
        raise UsageError(f"driven places of shape {driven.shape}", expected="(N, 3) finite numbers, N at least 1")
    pitch = size_m * (1.0 - overlap)
    low, high = driven[:, :2].min(axis=0), driven[:, :2].max(axis=0)
    counts = np.maximum(np.ceil((high - low - overlap * size_m) / pitch), 1.0).astype(np.int64)
    corner = (low + high - counts * pitch) / 2.0
    cells = np.clip(((driven[:, :2] - corner) // pitch).astype(np.int64), 0, counts - 1)
    blocks = []
    for cell in np.unique(cells, axis=0):
        height = float(np.median(driven[(cells == cell).all(axis=1), 2]))
        x, y = (corner + (cell + 0.5) * pitch).tolist()
        blocks.append(Block((int(cell[0]), int(cell[1])), (x, y, height), size_m, overlap * size_m))
    return Division(tuple(blocks), int(counts.prod()) - len(blocks))


def views_of(block: Block, views: Sequence[RenderView], reach_m: float = REACH_M) -> tuple[RenderView, ...]:
    """The views that a block is trained on: taken in it, or looking into it from no farther than a reach.

    Args:
        block: which.
        views: of the scene, with pinhole lenses.
        reach_m: how near the part of the block that is seen must be to a camera outside.

    Returns:
        Those views, in their order.
    """
    if not views:
        return ()
    import shapely

    centres = np.concatenate([view.pose.translation for view in views])
    away = block.distance_m(centres)
    chosen = away == 0.0
    outside = ((away > 0.0) & (away <= reach_m)).nonzero()[0]
    sectors = [_sector(views[int(place)], reach_m) for place in outside]
    x, y, _ = block.origin_m
    half = block.size_m / 2.0
    chosen[outside] = shapely.intersects(shapely.box(x - half, y - half, x + half, y + half), sectors)
    return tuple(view for view, own in zip(views, chosen) if own)


def _sector(view: RenderView, reach_m: float) -> Any:
    """What a view sees of the ground's plan, up to a distance, however it is turned: a polygon of shapely."""
    import shapely

    columns, rows = (np.linspace(0.0, size, 5) for size in (view.width_px, view.height_px))
    grid = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    rays = view.lens.unproject(grid).direction
    plan = (rays @ view.pose.matrix()[0, :3, :3].T)[:, :2]
    centre = view.pose.translation[0, :2]
    rim = centre + reach_m * plan / np.maximum(np.linalg.norm(plan, axis=1, keepdims=True), 1e-9)
    return shapely.MultiPoint([centre, *rim]).convex_hull
