"""Builds planar polygons: one by its corners, or many at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float64, Int64
from mirror.errors import UsageError
from mirror.portable import arrays
from mirror.synth.model.labels import Label
from mirror.synth.model.materials import Material
from mirror.synth.model.surfaces import FACE, MOST_CORNERS, NO_IMAGE, NO_OBJECT, ROUND, Model, Side

Colour = Sequence[float] | Float64
LEAST_AREA_M2: Final = 1e-8


def polygon(
    corners: npt.ArrayLike,
    colour: Colour,
    material: Material,
    label: Label,
    *,
    side: Side = Side.NONE,
    u_axis: npt.ArrayLike | None = None,
    origin: npt.ArrayLike | None = None,
    texture: npt.ArrayLike | None = None,
    image: int = NO_IMAGE,
    images: int = 1,
    layout: int = 0,
    seed: int = 0,
    two_sided: bool = False,
) -> Model:
    """Build a planar convex polygon.

    Args:
        corners: (N, 3) metres, counter-clockwise seen from outside, 3 <= N <= 16.
        colour: linear reflectance, 0 to 1, of red, green and blue.
        material: material of the surface.
        label: semantic class of the surface.
        side: side of the body.
        u_axis: (3,) direction of u, projected into the plane and normalised. Default: horizontal, to the right seen
            from outside; the x axis for horizontal faces. v is 90 degrees counter-clockwise from u: upwards on walls.
        origin: (3,) point where u and v are 0; default: the middle of the polygon's extents in u and v.
        texture: (N, 2) u and v at the corners, instead of ``u_axis`` and ``origin``; the first three corners that
            are not collinear define the affine map.
        image: image of the catalogue.
        images: number of consecutive images, from ``image`` on, that alternate between traversals.
        layout: row of markings.
        seed: seed of the texture.
        two_sided: whether the surface is visible from both sides.

    Raises:
        UsageError: there are too few or too many corners, or the corners are collinear.
    """
    points = np.asarray(corners, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or not 3 <= len(points) <= MOST_CORNERS:
        raise UsageError(f"a polygon with corners of shape {points.shape}", expected=f"(3 to {MOST_CORNERS}, 3)")
    ahead = np.roll(points, -1, axis=0)
    normal = np.cross(points - points[0], ahead - points[0]).sum(axis=0)
    size = float(arrays.norm(normal))
    if size < 2 * LEAST_AREA_M2:
        raise UsageError(
            "a polygon without area", place=str(points.tolist()), expected="corners that are not on a line"
        )
    normal = normal / size
    face = np.zeros(1, FACE)
    face["normal"], face["offset"] = normal, arrays.matmul(points.mean(axis=0), normal)
    if texture is None:
        u = _level(normal) if u_axis is None else np.asarray(u_axis, np.float64)
        u = u - (arrays.matmul(u, normal)) * normal
        u = u / arrays.norm(u)
        v = np.cross(normal, u)
        along, up = arrays.matmul(points, u), arrays.matmul(points, v)
        if origin is None:
            u0, v0 = -0.5 * (along.min() + along.max()), -0.5 * (up.min() + up.max())
        else:
            place = np.asarray(origin, np.float64)
            u0, v0 = -float(arrays.matmul(place, u)), -float(arrays.matmul(place, v))
    else:
        u, u0, v, v0 = _affine(points, np.asarray(texture, np.float64), normal)
        along, up = arrays.matmul(points, u), arrays.matmul(points, v)
    face["u_axis"], face["u0"], face["v_axis"], face["v0"] = u, u0, v, v0
    face["half"] = 0.5 * (along.max() - along.min()), 0.5 * (up.max() - up.min())
    face["colour"], face["count"], face["material"], face["label"], face["side"] = (
        colour,
        len(points),
        material,
        label,
        side,
    )
    face["image"], face["images"], face["layout"], face["seed"] = image, images, layout, seed
    face["object"], face["two_sided"] = NO_OBJECT, two_sided
    return Model(face, points, np.zeros(0, ROUND))


def polygons(
    corners: Float64,
    colours: npt.ArrayLike,
    material: Material | Int64,
    label: Label | Int64,
    *,
    texture: Float64 | None = None,
    layouts: npt.ArrayLike = 0,
    seeds: npt.ArrayLike = 0,
    two_sided: bool = False,
) -> Model:
    """Build many planar convex polygons with equally many corners at once, such as leaves and pieces of ground.

    Args:
        corners: (F, N, 3) metres, each counter-clockwise seen from outside.
        colours: (F, 3) or (3,) linear reflectance.
        material: (F,) materials, or one for all.
        label: (F,) semantic classes, or one for all.
        texture: (F, N, 2) u and v at the corners, affine over each polygon; default: u along the first edge, 0 in the
            middle of the polygon's extents.
        layouts: (F,) rows of markings, or one for all.
        seeds: (F,) seeds of the textures, or one for all.
        two_sided: whether the surfaces are visible from both sides.

    Raises:
        UsageError: a polygon has no area.
    """
    points = np.asarray(corners, np.float64)
    number, count = points.shape[:2]
    spokes = points - points[:, :1]
    normal = np.cross(spokes, np.roll(spokes, -1, axis=1)).sum(axis=1)
    size = np.linalg.norm(normal, axis=1)
    if (size < 2 * LEAST_AREA_M2).any():
        bad = int(np.argmin(size))
        raise UsageError(f"polygon {bad} has no area", place=str(points[bad].tolist()), expected="corners off a line")
    normal /= size[:, None]
    faces = np.zeros(number, FACE)
    middle = points.mean(axis=1)
    faces["normal"], faces["offset"] = normal, np.einsum("fi,fi->f", normal, middle)
    if texture is None:
        u = points[:, 1] - points[:, 0]
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        v = np.cross(normal, u)
        along, up = np.einsum("fni,fi->fn", points, u), np.einsum("fni,fi->fn", points, v)
        u0, v0 = -0.5 * (along.min(axis=1) + along.max(axis=1)), -0.5 * (up.min(axis=1) + up.max(axis=1))
    else:
        frame = np.stack([points[:, 1] - points[:, 0], points[:, 2] - points[:, 0], normal], axis=1)
        known = np.zeros((number, 3, 2))
        known[:, 0], known[:, 1] = texture[:, 1] - texture[:, 0], texture[:, 2] - texture[:, 0]
        axes = arrays.solve(frame, known)
        u, v = axes[:, :, 0], axes[:, :, 1]
        u0 = texture[:, 0, 0] - np.einsum("fi,fi->f", u, points[:, 0])
        v0 = texture[:, 0, 1] - np.einsum("fi,fi->f", v, points[:, 0])
    faces["u_axis"], faces["u0"], faces["v_axis"], faces["v0"] = u, u0, v, v0
    for axis, name in enumerate(("u_axis", "v_axis")):
        along = np.einsum("fni,fi->fn", points, faces[name])
        faces["half"][:, axis] = 0.5 * (along.max(axis=1) - along.min(axis=1))
    faces["colour"], faces["first"], faces["count"] = colours, np.arange(number) * count, count
    faces["material"], faces["label"], faces["side"] = material, label, Side.NONE
    faces["image"], faces["images"], faces["layout"], faces["seed"] = NO_IMAGE, 1, layouts, seeds
    faces["object"], faces["two_sided"] = NO_OBJECT, two_sided
    return Model(faces, points.reshape(-1, 3), np.zeros(0, ROUND))


def _level(normal: Float64) -> Float64:
    if abs(normal[2]) > 0.999:
        return np.array([1.0, 0.0, 0.0])
    return np.array([-normal[1], normal[0], 0.0])


def _affine(points: Float64, texture: Float64, normal: Float64) -> tuple[Float64, float, Float64, float]:
    edges = points[1:] - points[0]
    crossed = np.linalg.norm(np.cross(edges[0], edges[1:]), axis=1)
    other = 1 + int(np.argmax(crossed))
    frame = np.stack([edges[0], edges[other], normal])
    axes = arrays.solve(frame, np.vstack([texture[1] - texture[0], texture[1 + other] - texture[0], (0.0, 0.0)]))
    u, v = axes[:, 0], axes[:, 1]
    return u, float(texture[0, 0] - arrays.matmul(points[0], u)), v, float(texture[0, 1] - arrays.matmul(points[0], v))
