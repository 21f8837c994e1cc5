"""Rules of BOX, MSK: 3D boxes; masks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from mirror.arrays import Bool, Float64
from mirror.geometry.box_projection import project_boxes
from mirror.geometry.cameras import Camera
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import rotate
from mirror.integrity.finding import Cost, Finding, Severity
from mirror.integrity.layer_files import changed_files, missing_files, rows_without_image
from mirror.integrity.motion import MotionColumns
from mirror.integrity.rule import scene_rule
from mirror.integrity.scene_view import SceneView


@scene_rule(
    "BOX001",
    Severity.ERROR,
    title="A box's number is NaN or infinite, or its length, width or height is not positive.",
    remedy="correct the boxes where they come from, and write the layer again",
)
def _box_numbers(view: SceneView) -> Iterator[Finding]:
    boxes = view.boxes
    size = np.column_stack([boxes.floats(name) for name in ("length_m", "width_m", "height_m")])
    pose = np.column_stack([boxes.floats(name) for name in ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")])
    bad: Bool = np.asarray(~((np.isfinite(size) & (size > 0)).all(axis=1) & np.isfinite(pose).all(axis=1)))
    for name in ("vx_mps", "vy_mps", "vz_mps"):
        bad |= boxes.is_known(name) & ~np.isfinite(boxes.floats(name))
    yield from boxes.findings(
        bad, lambda row: f"size {size[row].tolist()} m, centre {pose[row, 4:].tolist()} m, or a velocity"
    )


@scene_rule(
    "BOX002",
    Severity.ERROR,
    title="A box's quaternion is not of unit length.",
    remedy="normalise the quaternions where they come from, and write the layer again",
)
def _box_quaternion(view: SceneView) -> Iterator[Finding]:
    boxes = view.boxes
    placed = MotionColumns(boxes)
    length = np.linalg.norm(placed.rotation, axis=1)
    yield from boxes.findings(
        ~placed.unit & np.isfinite(length),
        lambda row: f"length {length[row]:.9g}; expected 1",
        worst=np.abs(length - 1.0),
    )


@scene_rule(
    "BOX003",
    Severity.WARNING,
    title="A box is outside the field of view of every image.",
    remedy="check the boxes' frame and the calibration; nothing, if another sensor detected them",
)
def _box_unseen(view: SceneView) -> Iterator[Finding]:
    boxes = view.boxes
    placed = MotionColumns(boxes)
    size = np.column_stack([boxes.floats(name) for name in ("length_m", "width_m", "height_m")])
    usable = placed.unit & np.isfinite(placed.position).all(axis=1) & (np.isfinite(size) & (size > 0)).all(axis=1)
    cameras = _cameras(view) if len(boxes) else {}
    unseen = np.zeros(len(boxes), np.bool_)
    for _, number, rows in boxes.slices():
        left = np.flatnonzero(usable[rows]) + rows.start
        for camera, ego_SE3_camera in cameras.get(number, ()):
            ego_SE3_box = Poses(placed.rotation[left], placed.position[left])
            left = left[~project_boxes(camera, ego_SE3_camera.inverse() @ ego_SE3_box, size[left]).visible]
            if not len(left):
                break
        unseen[left] = number in cameras
    far = np.linalg.norm(placed.position, axis=1)
    yield from boxes.findings(
        unseen, lambda row: f"centre {np.round(placed.position[row], 2).tolist()} m in the ego frame", worst=-far
    )


def _cameras(view: SceneView) -> dict[int, list[tuple[Camera, Poses]]]:
    """Cameras that have images, with their mountings, of every stage, by traversal."""
    images, rows = view.images, view.all_calibrations
    codes, names = images.text_codes("camera")
    there = {(number, names[code]) for _, number, own in images.slices() for code in np.unique(codes[own]).tolist()}
    mounted = MotionColumns(rows)
    found: dict[int, list[tuple[Camera, Poses]]] = {}
    for row, camera in view.cameras.items():
        number = int(rows.traversal[row])
        finite = mounted.unit[row] and np.isfinite(mounted.position[row]).all()
        if finite and (number, rows.text("camera", row)) in there:
            pose = Poses(mounted.rotation[row : row + 1], mounted.position[row : row + 1])
            found.setdefault(number, []).append((camera, pose))
    return found


@scene_rule(
    "BOX004",
    Severity.WARNING,
    title="A track changes its category.",
    remedy="let the track keep the category it has most often, in a new version of the layer",
)
def _category_flip(view: SceneView) -> Iterator[Finding]:
    boxes = view.boxes
    category, names = boxes.text_codes("category")
    order = np.lexsort((boxes.integers("timestamp_ns"), boxes.text_codes("track_id")[0], boxes.owner))
    bad = np.zeros(len(boxes), np.bool_)
    before = np.full(len(boxes), -1)
    before[order[1:]] = order[:-1]
    same = before >= 0
    for codes in (boxes.owner, boxes.text_codes("track_id")[0]):
        same &= codes == codes[before]
    bad = same & (category != category[before])
    yield from boxes.findings(
        bad, lambda row: f"{names[category[row]]!r}, but {names[category[before[row]]]!r} one box before"
    )


_LONGEST_S = 1.5
_OFF_MPS = 3.0


_SHARE = 0.5


@scene_rule(
    "BOX005",
    Severity.WARNING,
    title="A track's velocities are not those of its displacement: in the median off by 3 m/s and by half.",
    remedy="check the velocity's frame (over ground, along the ego's axes) and unit",
)
def _box_velocity(view: SceneView) -> Iterator[Finding]:
    boxes = view.boxes
    if not len(boxes):
        return
    track = boxes.text_codes("track_id")[0]
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
    placed = MotionColumns(boxes)
    velocity = np.column_stack([boxes.floats(name) for name in ("vx_mps", "vy_mps")] + [np.zeros(len(boxes))])
    world, turned = np.full((len(boxes), 3), np.nan), np.full((len(boxes), 3), np.nan)
    covered = np.zeros(len(boxes), np.bool_)
    tracks = {number: rows for _, number, rows in poses.slices()}
    stamps, query = poses.integers("timestamp_ns"), boxes.integers("timestamp_ns")
    for _, number, rows in boxes.slices():
        own = tracks.get(number, slice(0, 0))
        if not view.has_valid_poses(own):
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


@scene_rule(
    "BOX006",
    Severity.ERROR,
    title="A box's score is not from 0 to 1.",
    remedy="write the layer again with scores from 0 to 1; null for a person's label",
)
def _box_score(view: SceneView) -> Iterator[Finding]:
    score = view.boxes.floats("score")
    bad = view.boxes.is_known("score") & ~((score >= 0.0) & (score <= 1.0))
    yield from view.boxes.findings(np.asarray(bad), lambda row: f"score {score[row]:g}")


@scene_rule(
    "BOX007",
    Severity.ERROR,
    title=(
        "A box is earlier than the first or later than the last pose of its traversal: it has no position in the world."
    ),
    remedy="write the layer again without the boxes outside the pass",
)
def _box_time(view: SceneView) -> Iterator[Finding]:
    first, last = view.pose_span()
    boxes = view.boxes
    stamps, number = boxes.integers("timestamp_ns"), boxes.traversal
    has_poses = (first <= last)[number]
    yield from boxes.findings(
        has_poses & ((stamps < first[number]) | (stamps > last[number])),
        lambda row: f"outside the poses, {first[number[row]]} to {last[number[row]]}",
    )


@scene_rule(
    "MSK001",
    Severity.ERROR,
    title="A mask's file is missing, or has another size than its row says.",
    cost=Cost.FILES,
    remedy="write the mask layer again",
)
def _mask_file(view: SceneView) -> Iterator[Finding]:
    yield from missing_files(view, view.masks)


@scene_rule(
    "MSK002",
    Severity.ERROR,
    title="A mask is of an image that was never recorded.",
    remedy="write the mask layer again, with the stamps of the images table",
)
def _mask_image(view: SceneView) -> Iterator[Finding]:
    yield from rows_without_image(view, view.masks)


@scene_rule(
    "MSK003",
    Severity.ERROR,
    title="A mask's file has other bytes than were written: another SHA-256.",
    cost=Cost.IMAGES,
    remedy="write the mask layer again",
)
def _mask_hash(view: SceneView) -> Iterator[Finding]:
    yield from changed_files(view, view.masks)
