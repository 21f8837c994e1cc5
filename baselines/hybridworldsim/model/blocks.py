"""The blocks of a scene: squares of 100 m that overlap by a quarter. Each block has its own origin."""

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
    """A square of the world's east-north plane and everything above it.

    The block's frame is the world's frame after a translation: ``block = world - origin_m``, subtracted in float64.

    Attributes:
        index: column and row in the scene's grid.
        origin_m: (x, y, z) of the centre in the world, on the ground.
        size_m: length of an edge.
        overlap_m: width of the strip that two neighbours share.
    """

    index: tuple[int, int]
    origin_m: tuple[float, float, float]
    size_m: float = SIZE_M
    overlap_m: float = OVERLAP * SIZE_M

    @property
    def name(self) -> str:
        """Name of the block's folder."""
        return f"block_{self.index[0]:02d}_{self.index[1]:02d}"

    @property
    def half_extent_m(self) -> float:
        """Distance along an axis from the block's centre to the end of its geometry: one overlap beyond its edge."""
        return self.size_m / 2.0 + self.overlap_m

    def local(self, points_m: Float64) -> Float64:
        """Convert points (N, 3) from the world to the block's frame."""
        return np.asarray(points_m, np.float64) - np.array(self.origin_m)

    def distance_m(self, points_m: Float64) -> Float64:
        """Return the distance (N,) of points (N, 2 or more) in the world from the block's square; 0 within it."""
        beyond = np.abs(np.asarray(points_m, np.float64)[:, :2] - np.array(self.origin_m[:2])) - self.size_m / 2.0
        return np.hypot(*np.maximum(beyond, 0.0).T)

    def far(self, points_m: Float64) -> Bool:
        """Mark which points (N, 3) in the world are so far outside that the block's sky node represents them."""
        beyond = np.abs(np.asarray(points_m, np.float64)[:, :2] - np.array(self.origin_m[:2]))
        return np.asarray((beyond > self.half_extent_m).any(axis=1))


@dataclass(frozen=True)
class Division:
    """The blocks of a scene.

    Attributes:
        blocks: blocks in which a vehicle drove, by column, then row.
        skipped: number of the grid's other blocks.
    """

    blocks: tuple[Block, ...]
    skipped: int


def divide(driven_m: Float64, size_m: float = SIZE_M, overlap: float = OVERLAP) -> Division:
    """Divide the driven area into blocks; the order of the places does not change the result.

    The grid is centred on the driven places and has as few columns and rows as possible. A block is kept if a vehicle
    drove in the part of it that is nearer to its centre than to any other centre.

    Args:
        driven_m: (N, 3) places of vehicles on the ground, in the world.
        size_m: edge of a block.
        overlap: overlap of neighbours, as a share of the edge, 0 to 0.5.

    Raises:
        UsageError: there is no place, a place is not finite, or the size or the overlap is out of range.
    """
    driven_places = np.asarray(driven_m, np.float64)
    if not size_m > 0.0 or not 0.0 <= overlap <= 0.5:
        raise UsageError(f"blocks of {size_m:g} m that overlap by {overlap:g}", expected="a size, and 0 to 0.5 of it")
    if (
        driven_places.ndim != 2
        or driven_places.shape[1] != 3
        or not len(driven_places)
        or not np.isfinite(driven_places).all()
    ):
        raise UsageError(
            f"driven places of shape {driven_places.shape}", expected="(N, 3) finite numbers, N at least 1"
        )
    pitch = size_m * (1.0 - overlap)
    low, high = driven_places[:, :2].min(axis=0), driven_places[:, :2].max(axis=0)
    counts = np.maximum(np.ceil((high - low - overlap * size_m) / pitch), 1.0).astype(np.int64)
    corner = (low + high - counts * pitch) / 2.0
    cells = np.clip(((driven_places[:, :2] - corner) // pitch).astype(np.int64), 0, counts - 1)
    blocks = []
    for cell in np.unique(cells, axis=0):
        height = float(np.median(driven_places[(cells == cell).all(axis=1), 2]))
        x, y = (corner + (cell + 0.5) * pitch).tolist()
        blocks.append(Block((int(cell[0]), int(cell[1])), (x, y, height), size_m, overlap * size_m))
    return Division(tuple(blocks), int(counts.prod()) - len(blocks))


def select_views(block: Block, views: Sequence[RenderView], reach_m: float = REACH_M) -> tuple[RenderView, ...]:
    """Select the views that a block is trained on: of cameras in the block, and of near cameras that see into it.

    Args:
        block: the block.
        views: views of the scene, with pinhole lenses.
        reach_m: a camera outside the block is selected if it sees a part of the block within this distance.

    Returns:
        The selected views, in their order.
    """
    if not views:
        return ()
    import shapely

    centres = np.concatenate([view.pose.translation for view in views])
    away = block.distance_m(centres)
    chosen = away == 0.0
    outside = ((away > 0.0) & (away <= reach_m)).nonzero()[0]
    sectors = [_view_sector(views[int(place)], reach_m) for place in outside]
    x, y, _ = block.origin_m
    half = block.size_m / 2.0
    chosen[outside] = shapely.intersects(shapely.box(x - half, y - half, x + half, y + half), sectors)
    return tuple(view for view, is_chosen in zip(views, chosen) if is_chosen)


def _view_sector(view: RenderView, reach_m: float) -> Any:
    """The area of the ground plan that a view sees up to a distance, at any rotation: a shapely polygon."""
    import shapely

    columns, rows = (np.linspace(0.0, size, 5) for size in (view.width_px, view.height_px))
    grid = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    rays = view.lens.unproject(grid).direction
    plan = (rays @ view.pose.matrix()[0, :3, :3].T)[:, :2]
    centre = view.pose.translation[0, :2]
    rim = centre + reach_m * plan / np.maximum(np.linalg.norm(plan, axis=1, keepdims=True), 1e-9)
    return shapely.MultiPoint([centre, *rim]).convex_hull
