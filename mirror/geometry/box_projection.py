"""Boxes in images: where a camera sees them, clipped at the near plane, at the lens's range and at the raster."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from mirror.arrays import AnyArray, Bool, Float64
from mirror.errors import UsageError
from mirror.geometry.blocks import split
from mirror.geometry.boxes import EDGES, FACES, corners, sizes
from mirror.geometry.cameras import Camera
from mirror.geometry.poses import Poses
from mirror.geometry.unit_quaternions import rotate_unit

_STEP_RAD: Final = np.radians(1.0)
_RIM_RAYS: Final = 360
_POINTS_AT_ONCE: Final = 1 << 16
# The rim is taken this much inside the range, on the side on which pixels are defined.
_RIM_SHARE: Final = 1.0 - 1e-9


@dataclass(frozen=True, eq=False)
class BoxProjections:
    """N boxes in one camera's image. Other objects are not considered: a box may be hidden.

    Attributes:
        visible: (N,) True where some point of the box is imaged within the raster.
        bounds_px: (N, 4) ``u_min v_min u_max v_max`` of what is imaged within the raster; NaN where not visible.
        camera: the camera.
        camera_SE3_box: the boxes' poses.
        lwh_m: (N, 3) their sizes.
        edges_m: (N, E, 2, 3) ends of the clipped edges in the camera frame, NaN where there is none.
        near_m: distance of the near plane.
    """

    visible: Bool
    bounds_px: Float64
    camera: Camera
    camera_SE3_box: Poses
    lwh_m: Float64
    edges_m: Float64
    near_m: float

    def __len__(self) -> int:
        return len(self.visible)

    def hull(self, index: int) -> Float64:
        """Return the convex hull of one box's image, not clipped to the raster.

        Returns:
            (K, 2) pixels, u towards v; (0, 2) where nothing of the box has a pixel.
        """
        one = slice(index, index + 1) if index >= 0 else slice(len(self) + index, len(self) + index + 1)
        boxes = _Boxes(self.camera_SE3_box[one], self.lwh_m[one], self.edges_m[one])
        with np.errstate(all="ignore"):
            steps = int(_steps(self.camera, boxes.edges)[0])
            curves, lost = _project_edges(self.camera, boxes.edges, max(steps, 1))
            points = [curves.reshape(-1, 2)]
            if _ends_at_rim(self.camera, boxes, lost)[0]:
                points.append(_seen_through(boxes, *_rim(self.camera), _near(self.camera, self.near_m))[0])
        return convex_hull(np.concatenate(points))


@dataclass(frozen=True, eq=False)
class _Boxes:
    camera_SE3_box: Poses
    lwh: Float64
    edges: Float64

    def __getitem__(self, rows: AnyArray) -> _Boxes:
        return _Boxes(self.camera_SE3_box[rows], self.lwh[rows], self.edges[rows])


def project_boxes(
    camera: Camera, camera_SE3_box: Poses, lwh_m: npt.ArrayLike, *, near_m: float = 0.1
) -> BoxProjections:
    """Project boxes.

    Under a perspective model a box is cut at the plane ``z = near_m``, edge by edge; a fisheye needs no plane. Edges
    are followed through the distortion in steps of one degree (a chord of one degree leaves a lens's curve by a few
    hundredths of a pixel) up to the range of the lens, and faces that fill the image or end at that range are found by
    rays, so that the bounds are those of the solid, not of its corners.

    Args:
        camera: the camera.
        camera_SE3_box: N poses of boxes in the camera frame.
        lwh_m: (N, 3) length, width, height in metres.
        near_m: distance of the near plane, above 0.

    Raises:
        UsageError: sizes do not fit, or ``near_m`` is not above 0.

    Example:
        >>> from mirror.geometry import Camera, Poses, project_boxes
        >>> camera = Camera("pinhole", 200, 100, fx_px=100.0, fy_px=100.0, cx_px=100.0, cy_px=50.0)
        >>> camera_SE3_box = Poses([[1.0, 0.0, 0.0, 0.0]], [[0.0, 0.0, 11.0]])
        >>> project_boxes(camera, camera_SE3_box, [[2.0, 2.0, 2.0]]).bounds_px
        array([[ 90.,  40., 110.,  60.]])
    """
    if not near_m > 0.0:
        raise UsageError(f"near plane at {near_m} m", expected="a distance above 0")
    lwh = sizes(camera_SE3_box, lwh_m)
    vertices = corners(camera_SE3_box, lwh)
    edges = _clip(vertices, near_m) if camera.lens.forward_only else vertices[:, EDGES]
    bounds = np.full((len(lwh), 4), np.nan)
    with np.errstate(all="ignore"):
        steps = _steps(camera, edges)
        cut = np.isfinite(edges[:, len(EDGES) :, 0, 0]).any(axis=1)
        for count in np.unique(steps[steps > 0]):
            for used in {len(EDGES), edges.shape[1]}:
                alike = np.flatnonzero((steps == count) & (cut == (used > len(EDGES))))
                size = max(1, _POINTS_AT_ONCE // (used * (int(count) + 1)))
                for start in range(0, len(alike), size):
                    rows = alike[start : start + size]
                    part = _Boxes(camera_SE3_box[rows], lwh[rows], edges[rows, :used])
                    bounds[rows] = _bounds(camera, part, int(count), near_m)
    return BoxProjections(np.isfinite(bounds[:, 0]), bounds, camera, camera_SE3_box, lwh, edges, near_m)


def convex_hull(points: npt.ArrayLike) -> Float64:
    """Return the corners of the convex hull of points in the plane (A. Andrew, Inf. Proc. Letters 9(5), 1979).

    Args:
        points: (P, 2); those that are not finite are left out.

    Returns:
        (K, 2), from the least x, turning from x towards y; no three on a line. K = 0, 1, 2 for none, one, a segment.
    """
    given = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    ordered = np.unique(given[np.isfinite(given).all(axis=1)], axis=0).tolist()
    if len(ordered) < 3:
        return np.array(ordered).reshape(-1, 2)

    def chain(way: list[list[float]]) -> list[list[float]]:
        hull: list[list[float]] = []
        for x, y in way:
            while len(hull) > 1:
                (ax, ay), (bx, by) = hull[-2:]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0.0:
                    break
                hull.pop()
            hull.append([x, y])
        return hull[:-1]

    return np.array(chain(ordered) + chain(ordered[::-1]))


def _clip(vertices: Float64, near: float) -> Float64:
    """Edges (N, E, 2, 3) of boxes cut at ``z = near``; E is 12, or 18 with the cut's edge in each face."""
    edges = vertices[:, EDGES]
    z = edges[..., 2]
    behind = z < near
    if not behind.any():
        return edges
    with np.errstate(all="ignore"):
        share = (near - z[..., 0]) / (z[..., 1] - z[..., 0])
        crossing = edges[..., 0, :] + share[..., None] * (edges[..., 1, :] - edges[..., 0, :])
    crossing[..., 2] = near
    edges = np.where(behind[..., None], crossing[:, :, None], edges)
    edges[behind.all(axis=-1)] = np.nan
    # Each face that is cut has two edges that are.
    cut = behind[..., 0] != behind[..., 1]
    of_face = cut[:, FACES]
    pair = np.take_along_axis(FACES[None], np.argsort(~of_face, axis=-1, kind="stable")[..., :2], axis=-1)
    ends = np.take_along_axis(crossing[:, None], pair[..., None], axis=2)
    ends[of_face.sum(axis=-1) != 2] = np.nan
    return np.concatenate((edges, ends), axis=1)


def _steps(camera: Camera, edges: Float64) -> AnyArray:
    """Return the number of chords along each box's edges: a power of two, or 0 for a box that is wholly behind."""
    start, end = edges[..., 0, :], edges[..., 1, :]
    angle = np.arctan2(np.linalg.norm(np.cross(start, end), axis=-1), np.einsum("nei,nei->ne", start, end))
    widest = np.asarray(np.fmax.reduce(angle, axis=1, initial=-1.0))
    steps = np.ones(len(edges), dtype=np.int64)
    if not camera.lens.straight:
        steps <<= np.ceil(np.log2(np.maximum(widest / _STEP_RAD, 1.0))).astype(np.int64)
    return np.where(widest < 0.0, 0, steps)


def _bounds(camera: Camera, boxes: _Boxes, steps: int, near: float) -> Float64:
    curves, lost = _project_edges(camera, boxes.edges, steps)
    lost = _ends_at_rim(camera, boxes, lost)
    size = np.array([camera.width_px, camera.height_px], dtype=np.float64)
    points = curves.reshape(len(curves), -1, 2)
    inside = _within(points, size)
    bounds = _least_and_greatest(points, inside)
    # Where all of a box is in the image, its edges are its bounds; the others end at the raster or the lens's range.
    rows = np.flatnonzero(lost | ~(inside | np.isnan(points[..., 0])).all(axis=-1))
    if len(rows):
        found = [points[rows], _border_crossings(curves[rows], size)]
        image_corners = size * ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
        rays = camera.unproject(image_corners)
        found.append(_seen_through(boxes[rows], rays.direction, image_corners, _near(camera, near)))
        if lost.any():
            found.append(_seen_through(boxes[rows], *_rim(camera), _near(camera, near)))
        candidates = np.concatenate(found, axis=1)
        bounds[rows] = _least_and_greatest(candidates, _within(candidates, size))
    return bounds


def _project_edges(camera: Camera, edges: Float64, steps: int) -> tuple[Float64, Bool]:
    """Pixels (N, E, steps + 1, 2) along edges, and which boxes (N,) have edges that leave the lens's range."""
    if steps == 1:
        directions = edges
    else:
        start, end = (side / np.linalg.norm(side, axis=-1, keepdims=True) for side in np.moveaxis(edges, 2, 0))
        angle = 2.0 * np.arcsin(np.minimum(0.5 * np.linalg.norm(end - start, axis=-1), 1.0))[..., None, None]
        share = np.linspace(0.0, 1.0, steps + 1)[:, None]
        tiny = angle < 1e-6
        of_start = np.where(tiny, 1.0 - share, np.sin((1.0 - share) * angle))
        of_end = np.where(tiny, share, np.sin(share * angle))
        directions = of_start * start[:, :, None] + of_end * end[:, :, None]
    projection = camera.project(directions)
    defined = projection.defined
    lost = np.logical_and(~defined, np.isfinite(edges[:, :, :1, 0]))
    uv = projection.uv_px
    if lost.any():
        for towards in (1, -1):
            outside = lost & np.roll(defined, towards, axis=2)
            outside[:, :, 0 if towards == 1 else -1] = False
            at = np.nonzero(outside)
            last = _last_in_range(camera, directions[at[0], at[1], at[2] - towards], directions[at])
            uv[at] = camera.project(last).uv_px
    return uv, np.asarray(lost.any(axis=(1, 2)))


def _last_in_range(camera: Camera, inside: AnyArray, outside: AnyArray) -> AnyArray:
    """Find where the way from directions in the lens's range to others leaves it: c^2 |p|^2 = z^2, a quadratic."""
    cosine = np.cos(camera.angle_limit_rad * _RIM_SHARE)
    inside = inside / np.linalg.norm(inside, axis=-1, keepdims=True)
    way = outside / np.linalg.norm(outside, axis=-1, keepdims=True) - inside
    a = way[:, 2] ** 2 - cosine**2 * np.einsum("ni,ni->n", way, way)
    b = inside[:, 2] * way[:, 2] - cosine**2 * np.einsum("ni,ni->n", inside, way)
    c = inside[:, 2] ** 2 - cosine**2
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    shares = np.stack(((-b - root) / a, (-b + root) / a))
    z = inside[:, 2] + shares * way[:, 2]
    shares = np.where((shares >= 0.0) & (shares <= 1.0) & (z * cosine >= 0.0), shares, np.nan)
    return inside + np.fmin.reduce(shares, axis=0)[:, None] * way


def _border_crossings(curves: Float64, size: Float64) -> Float64:
    """Find where the chords of curves (N, E, P, 2) cross the four lines of the raster's border: (N, C, 2)."""
    found = []
    start, end = curves[:, :, :-1], curves[:, :, 1:]
    for axis in (0, 1):
        for line in (0.0, size[axis]):
            crosses = (start[..., axis] < line) != (end[..., axis] < line)
            share = (line - start[..., axis]) / (end[..., axis] - start[..., axis])
            point = start + share[..., None] * (end - start)
            point[..., axis] = line
            found.append(np.where(crosses[..., None], point, np.nan).reshape(len(curves), -1, 2))
    return np.concatenate(found, axis=1)


def _seen_through(boxes: _Boxes, rays: Float64, pixels: Float64, near: float) -> Float64:
    """Of pixels (R, 2) with rays (R, 3), those (N, R, 2) through which each box is seen; NaN for the others."""
    box_SE3_camera = boxes.camera_SE3_box.inverse()
    direction = rotate_unit(box_SE3_camera.rotation[:, None], rays[None])
    origin, half = box_SE3_camera.translation[:, None], 0.5 * boxes.lwh[:, None]
    with np.errstate(all="ignore"):
        one, other = (-half - origin) / direction, (half - origin) / direction
        enter = np.fmax.reduce(np.fmin(one, other), axis=-1)
        leave = np.fmin.reduce(np.fmax(one, other), axis=-1)
        hit = (leave >= enter) & (leave >= near / np.abs(rays[:, 2])) & np.isfinite(rays[:, 0])
    return np.where(hit[..., None], pixels, np.nan)


def _ends_at_rim(camera: Camera, boxes: _Boxes, lost: Bool) -> Bool:
    """Mark boxes (N,) that are seen up to the lens's range: an edge leaves it, or all of it lies behind one face."""
    if camera.lens.forward_only:
        return lost
    rays, pixels = _rim(camera)
    return np.logical_or(lost, np.isfinite(_seen_through(boxes, rays[:1], pixels[:1], 0.0)[:, 0, 0]))


def _rim(camera: Camera) -> tuple[Float64, Float64]:
    """Rays (R, 3) just inside the lens's range, all round, and their pixels (R, 2)."""
    angle = camera.angle_limit_rad * _RIM_SHARE
    around = np.linspace(0.0, 2.0 * np.pi, _RIM_RAYS, endpoint=False)
    rays = np.stack(
        (np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.full(_RIM_RAYS, np.cos(angle))), axis=-1
    )
    return rays, camera.project(rays).uv_px


def _near(camera: Camera, near: float) -> float:
    return near if camera.lens.forward_only else 0.0


def _least_and_greatest(points: Float64, chosen: Bool) -> Float64:
    """Bounds (N, 4) of the chosen ones of points (N, P, 2); NaN where none is."""
    bounds = np.full((len(points), 4), np.nan)
    some = chosen.any(axis=1)
    for axis, values in enumerate(split(points[some])):
        bounds[some, axis] = np.where(chosen[some], values, np.inf).min(axis=1, initial=np.inf)
        bounds[some, 2 + axis] = np.where(chosen[some], values, -np.inf).max(axis=1, initial=-np.inf)
    return bounds


def _within(points: Float64, size: Float64) -> Bool:
    u, v = points[..., 0], points[..., 1]
    return np.asarray((u >= 0.0) & (u <= size[0]) & (v >= 0.0) & (v <= size[1]))
