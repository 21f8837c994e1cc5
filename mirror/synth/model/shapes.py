"""Builds models of single shapes: polygons, blocks, prisms, extruded profiles, tubes, wheels, ellipsoids."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float64, Int64
from mirror.errors import UsageError
from mirror.synth.model.labels import Label
from mirror.synth.model.materials import Material
from mirror.synth.model.surfaces import FACE, MOST_CORNERS, NO_IMAGE, NO_OBJECT, ROUND, Model, Side, merge_models
from mirror.synth.portable import arrays, scalars

Colour = Sequence[float] | Float64
_LEAST_AREA_M2 = 1e-8


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
    if size < 2 * _LEAST_AREA_M2:
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
    """Build many planar convex polygons with the same number of corners at once: leaves, pieces of ground.

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
    if (size < 2 * _LEAST_AREA_M2).any():
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


def block(
    centre: Sequence[float],
    size: Sequence[float],
    colour: Colour,
    material: Material,
    label: Label,
    *,
    slope: tuple[float, float] = (0.0, 0.0),
    yaw: float = 0.0,
    seed: int = 0,
    without: Sequence[Side] = (Side.BOTTOM,),
    materials: Mapping[Side, Material] | None = None,
    colours: Mapping[Side, Colour] | None = None,
    images: Mapping[Side, int] | None = None,
) -> Model:
    """Build a box; its front (+x) and back may be inclined.

    Args:
        centre: centre, metres.
        size: full extents along its own x (front), y (left) and z, metres.
        colour: colour of the sides that are not in ``colours``.
        material: material of the sides that are not in ``materials``.
        label: semantic class.
        slope: inward inclination of the front and the back, metres per metre of height.
        yaw: rotation about z, radians, counter-clockwise.
        seed: seed of the texture.
        without: sides that are left out.
        materials: materials of single sides.
        colours: colours of single sides.
        images: images of single sides.
    """
    x, y, z = (0.5 * extent for extent in size)
    middle_x, middle_y, middle_z = centre
    front, back = x - slope[0] * 2 * z, -x + slope[1] * 2 * z
    low = [(x, y, -z), (-x, y, -z), (-x, -y, -z), (x, -y, -z)]
    high = [(front, y, z), (back, y, z), (back, -y, z), (front, -y, z)]
    sides = {
        Side.FRONT: [low[3], low[0], high[0], high[3]],
        Side.BACK: [low[1], low[2], high[2], high[1]],
        Side.LEFT: [low[0], low[1], high[1], high[0]],
        Side.RIGHT: [low[2], low[3], high[3], high[2]],
        Side.TOP: high,
        Side.BOTTOM: low[::-1],
    }
    parts = [
        polygon(
            corners,
            (colours or {}).get(side, colour),
            (materials or {}).get(side, material),
            label,
            side=side,
            image=(images or {}).get(side, NO_IMAGE),
            seed=seed,
        )
        for side, corners in sides.items()
        if side not in without and not _flat(corners)
    ]
    return merge_models(parts).place(middle_x, middle_y, middle_z, yaw)


def _flat(corners: npt.ArrayLike) -> bool:
    points = np.asarray(corners)
    area = arrays.norm(np.cross(points - points[0], np.roll(points, -1, axis=0) - points[0]).sum(axis=0))
    return bool(area < 2 * _LEAST_AREA_M2)


def prism(
    outline: npt.ArrayLike,
    low_m: float,
    high_m: float,
    colour: Colour,
    material: Material,
    label: Label,
    *,
    top: Material | None = None,
    top_colour: Colour | None = None,
    bottom: bool = False,
    seed: int = 0,
) -> Model:
    """Build a vertical prism over a convex outline (N, 2), counter-clockwise, from ``low_m`` to ``high_m``.

    Args:
        outline: (N, 2) x and y, metres.
        low_m: height of the bottom.
        high_m: height of the top.
        colour: colour of the walls.
        material: material of the walls.
        label: semantic class.
        top: material of the top; default: that of the walls.
        top_colour: colour of the top; default: that of the walls.
        bottom: whether the prism has a bottom face.
        seed: seed of the texture.
    """
    points = np.asarray(outline, np.float64)
    low, high = np.c_[points, np.full(len(points), low_m)], np.c_[points, np.full(len(points), high_m)]
    parts = [
        polygon([low[i], low[j], high[j], high[i]], colour, material, label, seed=seed)
        for i, j in ((i, (i + 1) % len(points)) for i in range(len(points)))
    ]
    parts.append(
        polygon(
            high,
            colour if top_colour is None else top_colour,
            material if top is None else top,
            label,
            side=Side.TOP,
            seed=seed,
        )
    )
    if bottom:
        parts.append(polygon(low[::-1], colour, material, label, side=Side.BOTTOM, seed=seed))
    return merge_models(parts)


def extrusion(
    profile: npt.ArrayLike,
    width_m: float,
    colour: Colour,
    material: Material,
    label: Label,
    *,
    top_width_m: float | None = None,
    edges: Mapping[int, Material] | None = None,
    flank: Material | None = None,
    seed: int = 0,
) -> Model:
    """Extrude a convex side view sideways: bodies of vehicles.

    Args:
        profile: (N, 2) x and z: up the back, forward along the top, down the front.
        width_m: width along y at the lowest points.
        colour: colour of all faces.
        material: material of the faces that are not in ``edges`` and not flanks.
        label: semantic class.
        top_width_m: width at the highest points; default: ``width_m``.
        edges: materials of the faces over single edges, by the index of the edge's first point.
        flank: material of both flanks; default: ``material``.
        seed: seed of the texture.
    """
    points = np.asarray(profile, np.float64)
    low, high = points[:, 1].min(), points[:, 1].max()
    share = (points[:, 1] - low) / (high - low)
    half = 0.5 * (width_m + share * ((width_m if top_width_m is None else top_width_m) - width_m))
    left, right = np.c_[points[:, 0], half, points[:, 1]], np.c_[points[:, 0], -half, points[:, 1]]
    flanks = material if flank is None else flank
    parts = [
        polygon(left, colour, flanks, label, side=Side.LEFT, seed=seed),
        polygon(right[::-1], colour, flanks, label, side=Side.RIGHT, seed=seed),
    ]
    for i in range(len(points)):
        j = (i + 1) % len(points)
        corners = np.array([left[j], left[i], right[i], right[j]])
        outward = points[i, 1] - points[j, 1], points[j, 0] - points[i, 0]
        side = _side(*outward)
        parts.append(polygon(corners, colour, (edges or {}).get(i, material), label, side=side, seed=seed))
    return merge_models(parts)


def _side(x: float, z: float) -> Side:
    if abs(x) > abs(z):
        return Side.FRONT if x > 0 else Side.BACK
    return Side.TOP if z > 0 else Side.BOTTOM


def tube(
    start: Sequence[float],
    end: Sequence[float],
    radius_m: float,
    colour: Colour,
    material: Material,
    label: Label,
    *,
    end_radius_m: float | None = None,
    corners: int = 6,
    caps: bool = False,
    seed: int = 0,
) -> Model:
    """Build a straight tube with a polygonal cross-section: a pole, a trunk, a limb.

    Args:
        start: centre of one end, metres.
        end: centre of the other end, metres.
        radius_m: radius at the start.
        colour: colour of all faces.
        material: material of all faces; u runs around the tube, v along it.
        label: semantic class.
        end_radius_m: radius at the end; default: ``radius_m``.
        corners: number of corners of the cross-section.
        caps: whether the ends are closed.
        seed: seed of the texture.
    """
    first, last = np.asarray(start, np.float64), np.asarray(end, np.float64)
    along = last - first
    along = along / arrays.norm(along)
    across = np.cross(along, [1.0, 0.0, 0.0] if abs(along[0]) < 0.7 else [0.0, 1.0, 0.0])
    across = across / arrays.norm(across)
    aside = np.cross(along, across)
    angle = 2.0 * math.pi * (np.arange(corners) + 0.5) / corners
    round_ = np.outer(arrays.cos(angle), across) + np.outer(arrays.sin(angle), aside)
    low, high = first + radius_m * round_, last + (radius_m if end_radius_m is None else end_radius_m) * round_
    parts = []
    for i in range(corners):
        j = (i + 1) % corners
        ring = [low[i], low[j], high[j], high[i]] if end_radius_m != 0.0 else [low[i], low[j], high[i]]
        parts.append(polygon(ring, colour, material, label, seed=seed))
    if caps:
        parts.append(polygon(low[::-1], colour, material, label, seed=seed))
        if end_radius_m != 0.0:
            parts.append(polygon(high, colour, material, label, seed=seed))
    return merge_models(parts)


def wheel(centre: Sequence[float], radius_m: float, width_m: float, label: Label, *, corners: int = 12) -> Model:
    """Build a wheel around the y axis, with rims on both sides."""
    x, y, z = centre
    angle = 2.0 * math.pi * (np.arange(corners) + 0.5) / corners
    dx, dz = radius_m * arrays.cos(angle), radius_m * arrays.sin(angle)
    left = np.c_[x + dx, np.full(corners, y + 0.5 * width_m), z + dz]
    right = left - (0.0, width_m, 0.0)
    black = (0.02, 0.02, 0.02)
    parts = [
        polygon(left[::-1], black, Material.RIM, label, side=Side.LEFT),
        polygon(right, black, Material.RIM, label, side=Side.RIGHT),
    ]
    for i in range(corners):
        j = (i + 1) % corners
        parts.append(polygon([left[i], left[j], right[j], right[i]], black, Material.RUBBER, label))
    return merge_models(parts)


def ellipsoid(
    centre: Sequence[float],
    size: Sequence[float],
    colour: Colour,
    material: Material,
    label: Label,
    *,
    yaw: float = 0.0,
    pitch: float = 0.0,
    image: int = NO_IMAGE,
    seed: int = 0,
) -> Model:
    """Build an ellipsoid.

    Args:
        centre: centre, metres.
        size: full extents along its own axes, metres.
        colour: linear reflectance.
        material: material of the surface.
        label: semantic class.
        yaw: rotation about z, radians, counter-clockwise.
        pitch: upward rotation of its own x axis, radians, applied before the yaw.
        image: image of the catalogue on the half towards its own +x.
        seed: seed of the texture.
    """
    record = np.zeros(1, ROUND)
    cos, sin, up_cos, up_sin = scalars.cos(yaw), scalars.sin(yaw), scalars.cos(pitch), scalars.sin(pitch)
    record["centre"], record["half"] = centre, 0.5 * np.asarray(size)
    record["axes"] = [
        [cos * up_cos, sin * up_cos, up_sin],
        [-sin, cos, 0.0],
        [-cos * up_sin, -sin * up_sin, up_cos],
    ]
    record["colour"], record["material"], record["label"], record["image"] = (
        colour,
        material,
        label,
        image,
    )
    record["seed"], record["object"] = seed, NO_OBJECT
    return Model(np.zeros(0, FACE), np.zeros((0, 3)), record)
