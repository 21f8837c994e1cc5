"""Rules of GEO: geographic positions, and the world frame derived from them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.dataset.splits.leaks import overlapping_scenes as overlapping
from mirror.geometry.geodesy import TangentFrame
from mirror.integrity.dataset_view import DatasetView
from mirror.integrity.finding import Finding, Severity
from mirror.integrity.rule import dataset_rule, scene_rule
from mirror.integrity.scene_view import SceneView

_TOLERANCE_M = 0.01


@scene_rule(
    "GEO001",
    Severity.ERROR,
    title="A recorded pose's place in the world is not the one of its longitude and latitude.",
    remedy="`mirror ingest RECORDING... --replace`: both columns come from one fix",
)
def _world_place(view: SceneView) -> Iterator[Finding]:
    scene, poses = view.scene, view.poses
    if scene.longitude_deg is None or scene.latitude_deg is None or not len(poses):
        return
    # Where the source has no height, the scene's stands in for it.
    height = np.where(poses.is_known("height_m"), poses.floats("height_m"), scene.height_m)
    frame = TangentFrame(scene.longitude_deg, scene.latitude_deg, scene.height_m)
    expected = frame.from_geodetic(poses.floats("longitude_deg"), poses.floats("latitude_deg"), height)
    world = np.column_stack([poses.floats(name) for name in ("tx_m", "ty_m", "tz_m")])
    off = np.linalg.norm(world - expected, axis=1)
    yield from poses.findings(
        off > _TOLERANCE_M,
        lambda row: f"{off[row]:.3f} m from where its longitude and latitude are; expected below {_TOLERANCE_M} m",
        worst=off,
    )


_JUMP_M = 2.0
_GRADE = 0.35


@scene_rule(
    "GEO002",
    Severity.WARNING,
    title="The height jumps: from one pose to the next by over 2 m more than the steepest street climbs.",
    remedy="smooth the height into a pose layer, or check for a change of the geoid",
)
def _height_jump(view: SceneView) -> Iterator[Finding]:
    motion = view.motion
    climb = np.abs(motion.step_m[:, 2])
    yield from view.all_poses.findings(
        climb > _JUMP_M + _GRADE * motion.distance_m,
        lambda row: f"{motion.step_m[row, 2]:+.2f} m over {motion.distance_m[row]:.2f} m of way",
        worst=climb,
    )


_MOVING_MPS = 2.0
_LIMIT_DEG = 45.0


@scene_rule(
    "GEO003",
    Severity.WARNING,
    title=(
        "Over most of the distance the heading differs from the direction of travel: a wrong body frame or heading."
    ),
    remedy="check the source's body frame: x forward, y left, z up",
)
def _heading(view: SceneView) -> Iterator[Finding]:
    poses, motion = view.all_poses, view.motion
    forward = motion.forward()
    along = (forward * motion.step_m[:, :2]).sum(axis=1)
    across = forward[:, 0] * motion.step_m[:, 1] - forward[:, 1] * motion.step_m[:, 0]
    angle = np.degrees(np.arctan2(across, along))
    # A heading that was taken from the course says nothing about the source's.
    codes, words = poses.text_codes("orientation")
    recorded = codes != (words.index("course") if "course" in words else len(words))
    moving = recorded & view.has_motion[poses.traversal] & (motion.speed_mps > _MOVING_MPS) & np.isfinite(angle)
    way = np.where(moving, motion.distance_m, 0.0)
    wrong = np.where(moving & (np.abs(angle) > _LIMIT_DEG), motion.distance_m, 0.0)
    total = np.bincount(poses.owner, way, minlength=len(poses.files))
    astray = np.bincount(poses.owner, wrong, minlength=len(poses.files))
    for owner in np.flatnonzero(astray > 0.5 * total).tolist():
        own = angle[(poses.owner == owner) & moving]
        yield Finding(
            poses.files[owner],
            None,
            f"on {astray[owner]:.0f} of {total[owner]:.0f} m the heading is over {_LIMIT_DEG:g} degrees off the course"
            f" (median {np.median(own):+.0f} degrees, left positive)",
        )


_LIMIT_DEG = 30.0


@scene_rule(
    "GEO004",
    Severity.WARNING,
    title="The vehicle is tilted by more than 30 degrees: no street is that steep.",
    remedy="check the source's body frame and angles: x forward, y left, z up",
)
def _tilt(view: SceneView) -> Iterator[Finding]:
    motion = view.motion
    angle = np.degrees(np.arccos(np.clip(motion.up(), -1.0, 1.0)))
    yield from view.all_poses.findings(
        motion.unit & (angle > _LIMIT_DEG), lambda row: f"tilted by {angle[row]:.1f} degrees", worst=angle
    )


@dataset_rule(
    "GEO005",
    Severity.INFO,
    title="Two scenes overlap: their circles are closer than the sum of their radii.",
    remedy="nothing to do: a split by scene keeps them in one role",
)
def _overlapping_scenes(view: DatasetView) -> Iterator[Finding]:
    for first, second, distance in overlapping(view.scenes.values()):
        yield Finding(
            "rois.geojson",
            f"scenes {first.scene_id} and {second.scene_id}",
            f"{distance:.1f} m apart with radii of {first.radius_m:g} m and {second.radius_m:g} m",
        )
