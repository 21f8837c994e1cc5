"""Builds models of single shapes of polygons: blocks, prisms, extruded profiles, tubes, wheels; and ellipsoids."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from mirror.portable import arrays, scalars
from mirror.synth.model.labels import Label
from mirror.synth.model.materials import Material
from mirror.synth.model.polygons import LEAST_AREA_M2, Colour, polygon
from mirror.synth.model.surfaces import FACE, NO_IMAGE, NO_OBJECT, ROUND, Model, Side, merge_models


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
    return bool(area < 2 * LEAST_AREA_M2)


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
    """Extrude a convex side view sideways, such as the body of a vehicle.

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
