"""Builds many tubes or ellipsoids at once: limbs of people and branches of trees."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float64
from mirror.portable import arrays
from mirror.synth.model.labels import Label
from mirror.synth.model.materials import Material
from mirror.synth.model.polygons import polygons
from mirror.synth.model.surfaces import FACE, NO_IMAGE, NO_OBJECT, ROUND, Model


def tubes(
    starts: Float64,
    ends: Float64,
    radii: Float64,
    end_radii: Float64,
    colours: npt.ArrayLike,
    material: Material,
    label: Label,
    *,
    corners: int = 6,
    seed: int = 0,
) -> Model:
    """Build straight tapered tubes, open at both ends, with a polygonal cross-section.

    Args:
        starts: (N, 3) centres of the first ends, metres.
        ends: (N, 3) centres of the second ends, metres.
        radii: (N,) radii at the starts, metres.
        end_radii: (N,) radii at the ends, metres; above 0.
        colours: (N, 3) or (3,) linear reflectance.
        material: material of all tubes.
        label: semantic class of all tubes.
        corners: number of corners of the cross-sections.
        seed: seed of all textures.

    Raises:
        UsageError: a tube has no length or no radius.
    """
    along = ends - starts
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    across = np.cross(along, np.where(np.abs(along[:, :1]) < 0.7, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]]))
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    aside = np.cross(along, across)
    angle = 2.0 * math.pi * (np.arange(corners + 1) + 0.5) / corners
    ring = arrays.cos(angle)[:, None] * across[:, None] + arrays.sin(angle)[:, None] * aside[:, None]
    low, high = starts[:, None] + radii[:, None, None] * ring, ends[:, None] + end_radii[:, None, None] * ring
    quads = np.stack([low[:, :-1], low[:, 1:], high[:, 1:], high[:, :-1]], axis=2).reshape(-1, 4, 3)
    each = np.broadcast_to(np.asarray(colours, np.float64), (len(starts), 3))
    return polygons(quads, np.repeat(each, corners, axis=0), material, label, seeds=seed)


def ellipsoids(
    centres: npt.ArrayLike,
    halves: npt.ArrayLike,
    colours: npt.ArrayLike,
    materials: npt.ArrayLike,
    label: Label,
    *,
    axes: npt.ArrayLike | None = None,
    images: npt.ArrayLike = NO_IMAGE,
    seeds: npt.ArrayLike = 0,
) -> Model:
    """Build ellipsoids.

    Args:
        centres: (N, 3) centres, metres.
        halves: (N, 3) semi-axes, metres.
        colours: (N, 3) or (3,) linear reflectance.
        materials: (N,) materials, or one for all.
        label: semantic class of all ellipsoids.
        axes: (N, 3, 3) directions of the axes as rows; default: the axes of the frame.
        images: (N,) images of the catalogue, or one for all; they cover the half towards the ellipsoid's +x.
        seeds: (N,) seeds of the textures, or one for all.
    """
    middle = np.asarray(centres, np.float64)
    rounds = np.zeros(len(middle), ROUND)
    rounds["centre"], rounds["half"], rounds["colour"] = middle, halves, colours
    rounds["axes"] = np.eye(3) if axes is None else axes
    rounds["material"], rounds["label"], rounds["image"] = materials, label, images
    rounds["seed"], rounds["object"] = seeds, NO_OBJECT
    return Model(np.zeros(0, FACE), np.zeros((0, 3)), rounds)
