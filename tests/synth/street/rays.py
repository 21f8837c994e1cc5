"""Independent reference in numpy: intersections of rays with the faces of a model."""

from __future__ import annotations

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.synth.model import Model


def corners_of(model: Model) -> Float64:
    """Corners (C, 3), face by face."""
    first, count = model.faces["first"], model.faces["count"]
    begins = np.cumsum(count) - count
    corners: Float64 = model.corners[np.repeat(first - begins, count) + np.arange(count.sum())]
    return corners


def nearest(model: Model, origins: Float64, directions: Float64, *, fronts_only: bool = False) -> tuple[Int64, Float64]:
    """First face (N,) that each ray hits, from either side or the front only (-1: none), and its distance."""
    faces = model.faces
    found, distance = np.full(len(origins), -1), np.full(len(origins), np.inf)
    for number, face in enumerate(faces):
        along = directions @ face["normal"]
        with np.errstate(divide="ignore", invalid="ignore"):
            far = (face["offset"] - origins @ face["normal"]) / along
        hit = np.isfinite(far) & (far > 1e-6) & (far < distance)
        if fronts_only and not face["two_sided"]:
            hit &= along < 0.0
        places = origins + np.where(hit, far, 0.0)[:, None] * directions
        corners = model.corners[face["first"] : face["first"] + face["count"]]
        for start, end in zip(corners, np.roll(corners, -1, axis=0)):
            hit &= (places - start) @ np.cross(face["normal"], end - start) >= -1e-9
        found[hit], distance[hit] = number, far[hit]
    return found, distance


def seen_from_behind(model: Model, count: int, seed: int) -> list[int]:
    """Faces that rays from all directions first hit from behind: openings of the model."""
    rng = np.random.default_rng(seed)
    low, high = model.bounds()
    middle, reach = 0.5 * (low + high), float(np.linalg.norm(high - low))
    bearing = rng.uniform(0.0, 2.0 * np.pi, count)
    height = np.where(rng.random(count) < 0.7, rng.uniform(0.5, 3.0, count), rng.uniform(3.0, 60.0, count))
    origins = np.c_[middle[0] + reach * np.cos(bearing), middle[1] + reach * np.sin(bearing), height]
    targets = rng.uniform(np.maximum(low, (-np.inf, -np.inf, 0.05)), high, (count, 3))
    directions = targets - origins
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    both = model.faces["two_sided"] == 1
    found, distance = nearest(model, origins, directions)
    faces = model.faces[found]
    behind = (found >= 0) & (np.einsum("ni,ni->n", faces["normal"], directions) > 1e-9) & ~both[found]
    # If two faces lie back to back in one plane, the front of one is hit at the same distance.
    _, to_front = nearest(model, origins[behind], directions[behind], fronts_only=True)
    open_ = found[behind][to_front > distance[behind] + 1e-6]
    return sorted(set(open_.tolist()))
