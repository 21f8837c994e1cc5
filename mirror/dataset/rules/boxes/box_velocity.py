"""BOX005."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.dataset.check.motion import Motion
from mirror.dataset.check.rule import Finding, Severity, scene_rule
from mirror.dataset.check.scene_view import SceneView
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import rotate

_LONGEST_S = 1.5
_OFF_MPS = 3.0
_SHARE = 0.5


@scene_rule(
    "BOX005", Severity.WARNING, remedy="check the velocity's frame (over ground, along the ego's axes) and unit"
)
def box_velocity(view: SceneView) -> Iterator[Finding]:
    """A track's velocities are not those of its displacement: in the median off by 3 m/s and by half."""
    boxes = view.boxes
    if not len(boxes):
        return
    track = boxes.words("track_id")[0]
    world, turned, placed = _in_world(view)
    order = np.lexsort((boxes.integers("timestamp_ns"), track, boxes.owner))
    one, two = order[:-1], order[1:]
    seconds = (boxes.integers("timestamp_ns")[two] - boxes.integers("timestamp_ns")[one]) * 1e-9
    usable = (track[one] == track[two]) & (boxes.owner[one] == boxes.owner[two]) & placed[one] & placed[two]
    usable &= (seconds > 0) & (seconds <= _LONGEST_S) & np.isfinite(turned[two] + turned[one]).all(axis=1)
    one, two, seconds = one[usable], two[usable], seconds[usable]
    moved = (world[two] - world[one])[:, :2] / seconds[:, None]
    stated = 0.5 * (turned[one] + turned[two])[:, :2]
    off = np.linalg.norm(moved - stated, axis=1)
    speed = np.maximum(np.linalg.norm(moved, axis=1), np.linalg.norm(stated, axis=1))
    bad = np.zeros(len(boxes), np.bool_)
    worst = np.zeros(len(boxes))
    edges = np.flatnonzero(np.diff(track[two]) | np.diff(boxes.owner[two])) + 1
    for own in np.split(np.arange(len(two)), edges) if len(two) else ():
        error, pace = float(np.median(off[own])), float(np.median(speed[own]))
        if error > max(_OFF_MPS, _SHARE * pace):
            bad[two[own[0]]] = True
            worst[two[own[0]]] = error
    yield from boxes.findings(bad, lambda row: f"median error of the track {worst[row]:.1f} m/s", worst=worst)


def _in_world(view: SceneView) -> tuple[Float64, Float64, Bool]:
    """Centres (N, 3) and velocities (N, 3) of boxes in the world, and which boxes have a recorded pose."""
    boxes, poses = view.boxes, view.poses
    placed = Motion(boxes)
    velocity = np.column_stack([boxes.floats(name) for name in ("vx_mps", "vy_mps")] + [np.zeros(len(boxes))])
    world, turned = np.full((len(boxes), 3), np.nan), np.full((len(boxes), 3), np.nan)
    covered = np.zeros(len(boxes), np.bool_)
    tracks = {number: rows for _, number, rows in poses.slices()}
    stamps, query = poses.integers("timestamp_ns"), boxes.integers("timestamp_ns")
    for _, number, rows in boxes.slices():
        own = tracks.get(number, slice(0, 0))
        if not view.sound_poses(own):
            continue
        inside = np.flatnonzero((query[rows] >= stamps[own][0]) & (query[rows] <= stamps[own][-1])) + rows.start
        inside = inside[np.isfinite(placed.position[inside]).all(axis=1)]
        world_SE3_ego = interpolate(
            stamps[own], Poses(view.motion.rotation[own], view.motion.position[own]), query[inside]
        )
        world[inside] = world_SE3_ego.transform(placed.position[inside][:, None])[:, 0]
        turned[inside] = rotate(world_SE3_ego.rotation, velocity[inside])
        covered[inside] = True
    return world, turned, covered
