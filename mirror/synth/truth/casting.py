"""Casts single rays against a model in float64: exact distances, and the surface that each ray hits."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numba import njit

from mirror.arrays import Bool, Float64, Int64, UInt8
from mirror.compiled import inner_numpy_njit
from mirror.geometry import Poses, matrix_from_quaternion, project_boxes
from mirror.geometry.cameras import Camera
from mirror.portable import arrays
from mirror.synth.model import Model

NOTHING: Final = -1


def cast_rays(model: Model, origin: Float64, directions: Float64) -> tuple[Float64, Int64]:
    """Find the first surface on each ray; faces are visible from outside, two-sided faces from both sides.

    Args:
        model: model in any frame.
        origin: (3,) origin of all rays, in the same frame; not inside an ellipsoid.
        directions: (N, 3) directions of any length above 0.

    Returns:
        Distances (N,) in units of the directions' lengths, infinite without a hit; and indices (N,) of the surfaces:
        faces first, then ellipsoids; NOTHING without a hit.
    """
    rays = np.ascontiguousarray(directions, np.float64)
    distance, index = np.full(len(rays), np.inf), np.full(len(rays), NOTHING, np.int64)
    faces, rounds = model.faces, model.rounds
    _cast_faces(
        np.ascontiguousarray(faces["normal"]),
        np.ascontiguousarray(faces["offset"]),
        np.ascontiguousarray(faces["first"]),
        np.ascontiguousarray(faces["count"]),
        np.ascontiguousarray(faces["two_sided"]),
        np.ascontiguousarray(model.corners),
        np.asarray(origin, np.float64),
        rays,
        distance,
        index,
    )
    _cast_rounds(
        np.ascontiguousarray(rounds["centre"]),
        np.ascontiguousarray(rounds["axes"]),
        np.ascontiguousarray(rounds["half"]),
        len(faces),
        np.asarray(origin, np.float64),
        rays,
        distance,
        index,
    )
    return distance, index


def ego_mask(ego_model: Model, camera: Camera, ego_SE3_camera: Poses) -> UInt8:
    """Return the mask of a camera's own vehicle.

    Args:
        ego_model: model of the vehicle, in the ego frame.
        camera: the camera.
        ego_SE3_camera: one pose: the mounting of the camera.

    Returns:
        (H, W) mask: 255 where a ray through a corner, edge middle or centre of the pixel hits the vehicle, else 0.
    """
    mask = np.zeros((camera.height_px, camera.width_px), np.uint8)
    low, high = ego_model.bounds()
    box = Poses(np.array([[1.0, 0.0, 0.0, 0.0]]), 0.5 * (low + high)[None])
    there = project_boxes(camera, ego_SE3_camera.inverse() @ box, np.maximum(high - low, 1e-6)[None])
    if not there.visible[0]:
        return mask
    left, top = np.floor(there.bounds_px[0, :2]).astype(int)
    right, bottom = np.ceil(there.bounds_px[0, 2:]).astype(int)
    turn, origin = matrix_from_quaternion(ego_SE3_camera.rotation)[0], ego_SE3_camera.translation[0]
    u, v = np.meshgrid(0.5 * np.arange(2 * left, 2 * right + 1), 0.5 * np.arange(2 * top, 2 * bottom + 1))
    rays = camera.unproject(np.stack([u, v], axis=-1))
    is_hit = np.zeros(u.shape, np.bool_)
    is_hit[rays.valid] = cast_rays(ego_model, origin, arrays.matmul(rays.direction[rays.valid], turn.T))[1] != NOTHING
    mask[top:bottom, left:right] = np.where(_any_of_nine(is_hit), 255, 0)
    return mask


def _any_of_nine(lattice: Bool) -> Bool:
    rows = lattice[:-2:2] | lattice[1::2] | lattice[2::2]
    return rows[:, :-2:2] | rows[:, 1::2] | rows[:, 2::2]


@njit(cache=True, nogil=True, error_model="numpy")
def _cast_faces(
    normal: Float64,
    offset: Float64,
    first: Int64,
    count: Int64,
    two_sided: Int64,
    corners: Float64,
    origin: Float64,
    rays: Float64,
    distance: Float64,
    index: Int64,
) -> None:
    for f in range(len(offset)):
        nx, ny, nz = normal[f, 0], normal[f, 1], normal[f, 2]
        above = nx * origin[0] + ny * origin[1] + nz * origin[2] - offset[f]
        if above == 0.0 or (above < 0.0 and not two_sided[f]):
            continue
        for r in range(len(rays)):
            slope = nx * rays[r, 0] + ny * rays[r, 1] + nz * rays[r, 2]
            if slope * above >= 0.0:
                continue
            t = -above / slope
            if t >= distance[r]:
                continue
            if _is_inside(corners, first[f], count[f], normal[f], origin, rays[r], t):
                distance[r], index[r] = t, f


@inner_numpy_njit
def _is_inside(
    corners: Float64, first: int, count: int, normal: Float64, origin: Float64, ray: Float64, t: float
) -> bool:
    """Return whether a point in the plane of a face is inside the face: on the inner side of all its edges."""
    x, y, z = origin[0] + t * ray[0], origin[1] + t * ray[1], origin[2] + t * ray[2]
    last = first + count - 1
    ax, ay, az = corners[last, 0] - x, corners[last, 1] - y, corners[last, 2] - z
    for i in range(first, first + count):
        bx, by, bz = corners[i, 0] - x, corners[i, 1] - y, corners[i, 2] - z
        area = normal[0] * (ay * bz - az * by) + normal[1] * (az * bx - ax * bz) + normal[2] * (ax * by - ay * bx)
        if area < 0.0:
            return False
        ax, ay, az = bx, by, bz
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def _cast_rounds(
    centre: Float64,
    axes: Float64,
    half: Float64,
    start: int,
    origin: Float64,
    rays: Float64,
    distance: Float64,
    index: Int64,
) -> None:
    """Intersect rays with ellipsoids, in the frame in which the ellipsoid is the unit sphere."""
    for e in range(len(centre)):
        dx, dy, dz = origin[0] - centre[e, 0], origin[1] - centre[e, 1], origin[2] - centre[e, 2]
        ox = (axes[e, 0, 0] * dx + axes[e, 0, 1] * dy + axes[e, 0, 2] * dz) / half[e, 0]
        oy = (axes[e, 1, 0] * dx + axes[e, 1, 1] * dy + axes[e, 1, 2] * dz) / half[e, 1]
        oz = (axes[e, 2, 0] * dx + axes[e, 2, 1] * dy + axes[e, 2, 2] * dz) / half[e, 2]
        for r in range(len(rays)):
            x, y, z = rays[r, 0], rays[r, 1], rays[r, 2]
            rx = (axes[e, 0, 0] * x + axes[e, 0, 1] * y + axes[e, 0, 2] * z) / half[e, 0]
            ry = (axes[e, 1, 0] * x + axes[e, 1, 1] * y + axes[e, 1, 2] * z) / half[e, 1]
            rz = (axes[e, 2, 0] * x + axes[e, 2, 1] * y + axes[e, 2, 2] * z) / half[e, 2]
            square = rx * rx + ry * ry + rz * rz
            along = -(ox * rx + oy * ry + oz * rz)
            if along <= 0.0:
                continue
            # A cross product gives the ray's distance from the centre; a difference of squares would cancel.
            mx, my, mz = oy * rz - oz * ry, oz * rx - ox * rz, ox * ry - oy * rx
            room = square - (mx * mx + my * my + mz * mz)
            if room < 0.0:
                continue
            t = (along - math.sqrt(room)) / square
            if 0.0 < t < distance[r]:
                distance[r], index[r] = t, start + e
