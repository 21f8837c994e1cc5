"""The scale of a map from the other cameras of the rig, whose distances on the vehicle are known in metres.

Other cameras see points of the map. Where they are in the map follows from the way of the mapped camera at their own
exposures and from their mountings; one scale fits all their rays. Errors of the mountings' rotations are estimated too.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np

from mirror.arrays import Float64, Int64
from mirror.calibration.refinement.features import ImageFeatures, match_features
from mirror.errors import UsageError
from mirror.geometry import Poses, interpolate, matrix_from_quaternion, quaternion_exp
from mirror.geometry.cameras import Camera
from mirror.localisation.structure.maps import ImageMap, to_ideal
from mirror.localisation.structure.rig_adjustment import SeenByOther
from mirror.localisation.structure.used_images import UsedImages

LEAST_RAYS: Final = 60
_WILD_DEG: Final = 3.0
_SIGMA_DEG: Final = 0.05
_WORST_PERCENT: Final = 5.0
_BESIDE: Final = 2
"""Images of another camera are matched with this many mapped ones before and after."""
_NEAR: Final = 0.25
"""Images of other cameras join the adjustment within this share of the step between mapped images."""


@dataclass(frozen=True, eq=False)
class OtherCamera:
    """Another camera of the rig.

    Attributes:
        name: its name.
        lens: its lens.
        ego_SE3_camera: its mounting.
        sigma_deg: 1-sigma of the mounting's rotation relative to the mapped camera, about each axis.
        time_ns: (N,) middles of the exposures of its images.
        features: N sets of features.
    """

    name: str
    lens: Camera
    ego_SE3_camera: Poses
    sigma_deg: float
    time_ns: Int64
    features: Sequence[ImageFeatures]


@dataclass(frozen=True)
class RigScale:
    """A scale from a rig.

    Attributes:
        scale: metres per unit of the map.
        sigma_percent: 1-sigma, percent.
        rays: number of rays of other cameras, by camera.
        seen: the images of the other cameras with the points that they show, for an adjustment of the whole rig.
    """

    scale: float
    sigma_percent: float
    rays: dict[str, int]
    seen: Sequence[SeenByOther]


@dataclass(frozen=True, eq=False)
class _Rays:
    """Rays of one other camera: in the camera's frame, and the map's points and camera places that they belong to.

    ``image``, ``feature`` and ``point`` are the numbers of what each ray comes from.
    """

    ray: Float64
    turn: Float64
    unit: Float64
    metres: Float64
    image: Int64
    feature: Int64
    point: Int64


def scale_from_rig(
    images: UsedImages, found: ImageMap, ego_SE3_camera: Poses, others: Sequence[OtherCamera]
) -> RigScale:
    """Estimate the scale of a map.

    Args:
        images: the used images of the mapped camera.
        found: its map.
        ego_SE3_camera: its mounting.
        others: the other cameras, with images near the times of the mapped ones.

    Raises:
        UsageError: the other cameras see too few points of the map, or their distances do not determine the scale.
    """
    from scipy.optimize import least_squares

    each = {one.name: _gather(images, found, ego_SE3_camera, one) for one in others}
    gathered = {name: one for name, one in each.items() if one is not None and len(one.ray)}
    count = sum(len(one.ray) for one in gathered.values())
    if count < LEAST_RAYS:
        raise UsageError(
            f"other cameras see {count} points of the map", place="--scale rig",
            expected=f"at least {LEAST_RAYS}: cameras whose images overlap, now or one after the other",
            remedy="take the scale from elsewhere: --scale height --camera-height-m METRES, or --length-m METRES",
        )  # fmt: skip
    prior = np.array([np.radians(one.sigma_deg) for one in others if one.name in gathered])
    rays = list(gathered.values())

    def residuals(unknown: Float64) -> Float64:
        parts = []
        for number, one in enumerate(rays):
            turn = matrix_from_quaternion(quaternion_exp(unknown[None, 1 + 3 * number : 4 + 3 * number]))[0]
            world = np.einsum("nij,nj->ni", one.turn, one.ray @ turn.T)
            way = np.exp(unknown[0]) * one.unit - one.metres
            way /= np.linalg.norm(way, axis=1)[:, None]
            parts.append(np.degrees(np.cross(world, way)).ravel() / _SIGMA_DEG)
        return np.concatenate([*parts, unknown[1:] / np.repeat(prior, 3)])

    size = 1 + 3 * len(rays)
    tried = []
    for start in np.log(_likely_scales(rays)):
        unknown = np.zeros(size)
        unknown[0] = start
        tried.append(least_squares(residuals, unknown, loss="cauchy", x_scale="jac"))
    best = min(tried, key=lambda one: float(one.cost))
    sigma = 100.0 * float(np.sqrt(np.linalg.pinv(best.jac.T @ best.jac)[0, 0]))
    if not sigma < _WORST_PERCENT:
        raise UsageError(
            f"the distances of the cameras give the scale within {sigma:.0f} % only", place="--scale rig",
            expected=f"within {_WORST_PERCENT:.0f} %",
            remedy="take the scale from elsewhere: --scale height --camera-height-m METRES, or --length-m METRES",
        )  # fmt: skip
    scale, seen = float(np.exp(best.x[0])), list[SeenByOther]()
    for number, other in enumerate(one for one in others if one.name in gathered):
        turn = quaternion_exp(best.x[None, 1 + 3 * number : 4 + 3 * number])
        mounted = ego_SE3_camera.inverse() @ other.ego_SE3_camera @ Poses(turn, np.zeros((1, 3)))
        seen += _find_seen(images, found, scale, mounted, other, gathered[other.name])
    return RigScale(scale, sigma, {name: len(one.ray) for name, one in gathered.items()}, seen)


def _find_seen(
    images: UsedImages, found: ImageMap, scale: float, mapped_SE3_other: Poses, other: OtherCamera, rays: _Rays
) -> Iterator[SeenByOther]:
    """Yield what the images of another camera show of the map; those far from every mapped image in time are left out.

    Between mapped images the vehicle is taken to move evenly.
    """
    stamps = images.time_ns[found.used]
    metric = Poses(found.world_SE3_camera.rotation, found.world_SE3_camera.translation * scale)
    near = _NEAR * float(np.median(np.diff(stamps)))
    for number in np.unique(rays.image).tolist():
        frame = int(np.abs(stamps - other.time_ns[number]).argmin())
        if abs(int(stamps[frame]) - int(other.time_ns[number])) > near:
            continue
        own = rays.image == number
        placed = interpolate(stamps, metric, other.time_ns[number : number + 1]) @ mapped_SE3_other
        uv, kept = to_ideal(other.features[number], other.lens)
        place = np.full(len(other.features[number]), -1, np.int64)
        place[kept] = np.arange(len(kept))
        rows = place[rays.feature[own]]
        frame_SE3_other = metric[frame : frame + 1].inverse() @ placed
        yield SeenByOther(frame, frame_SE3_other, other.lens, uv[rows[rows >= 0]], rays.point[own][rows >= 0])


def _likely_scales(rays: Sequence[_Rays]) -> Float64:
    """Return scales to start from: quartiles of those of single rays."""
    single = []
    for one in rays:
        world = np.einsum("nij,nj->ni", one.turn, one.ray)
        along, metres = np.cross(world, one.unit), np.cross(world, one.metres)
        with np.errstate(invalid="ignore", divide="ignore"):
            single.append(np.einsum("ni,ni->n", along, metres) / np.einsum("ni,ni->n", along, along))
    values = np.concatenate(single)
    values = values[np.isfinite(values) & (values > 0.0)]
    if not len(values):
        return np.array([1.0])
    return np.asarray(np.quantile(values, (0.25, 0.5, 0.75, 0.9)), np.float64)


def _gather(images: UsedImages, found: ImageMap, ego_SE3_camera: Poses, other: OtherCamera) -> _Rays | None:
    """Match the images of another camera with the mapped images near them in time."""
    stamps = images.time_ns[found.used]
    inside = np.flatnonzero((other.time_ns >= stamps[0]) & (other.time_ns <= stamps[-1]))
    mapped_SE3_other = ego_SE3_camera.inverse() @ other.ego_SE3_camera
    between = interpolate(stamps, found.world_SE3_camera, other.time_ns[inside])
    ray, turn, unit, metres, sources = [], [], [], [], []
    for row, number in enumerate(inside.tolist()):
        pose = between[np.array([row])]
        turned = matrix_from_quaternion(pose.rotation)[0]
        nearest = int(np.abs(stamps - other.time_ns[number]).argmin())
        pairs = []
        for place in range(max(nearest - _BESIDE, 0), min(nearest + _BESIDE, len(stamps) - 1) + 1):
            points, shown = found.observed[place]
            by_feature = np.full(len(images.features[found.used[place]]), -1, np.int64)
            by_feature[shown] = points
            matched = match_features(images.features[found.used[place]], other.features[number])
            known = by_feature[matched[:, 0]] >= 0
            pairs.append(np.column_stack([by_feature[matched[known, 0]], matched[known, 1]]))
        own = np.unique(np.concatenate(pairs), axis=0)
        if not len(own):
            continue
        direction = other.lens.unproject(other.features[number].uv_px[own[:, 1]]).direction
        valid = np.isfinite(direction).all(axis=1)
        ray.append(direction[valid])
        sources.append(np.column_stack([np.full(int(valid.sum()), number), own[valid, 1], own[valid, 0]]))
        whole = turned @ matrix_from_quaternion(mapped_SE3_other.rotation)[0]
        turn.append(np.broadcast_to(whole, (int(valid.sum()), 3, 3)))
        unit.append(found.points[own[valid, 0]] - pose.translation)
        metres.append(np.broadcast_to(turned @ mapped_SE3_other.translation[0], (int(valid.sum()), 3)))
    if not ray:
        return None
    joined = _Rays(
        np.concatenate(ray), np.concatenate(turn), np.concatenate(unit), np.concatenate(metres),
        *np.concatenate(sources).astype(np.int64).T,
    )  # fmt: skip
    # A wrong match is far from every point of its epipolar line: from that of infinite scale and of the nearest.
    world = np.einsum("nij,nj->ni", joined.turn, joined.ray)
    plane = np.cross(joined.unit, joined.metres)
    length = np.linalg.norm(plane, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        off = np.degrees(np.arcsin(np.clip(np.abs(np.einsum("ni,ni->n", world, plane)) / length, 0.0, 1.0)))
    ahead = np.einsum("ni,ni->n", world, joined.unit) > 0.0
    kept = np.flatnonzero((off < _WILD_DEG) & ahead)
    return _Rays(*(getattr(joined, name.name)[kept] for name in fields(_Rays)))
