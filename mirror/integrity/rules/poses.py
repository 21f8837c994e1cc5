"""Rules of POS: the ego poses of a traversal, recorded and in layers."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pyarrow as pa

from mirror.arrays import Float64
from mirror.geometry.quaternions import angle_between_deg, quaternion_normalise
from mirror.integrity.finding import Finding, Severity
from mirror.integrity.motion import MotionColumns
from mirror.integrity.rule import scene_rule
from mirror.integrity.scene_view import SceneView
from mirror.schema.tables import EGO_POSES


@scene_rule(
    "POS001",
    Severity.ERROR,
    title="A pose is not later than the one before it.",
    remedy="`mirror ingest RECORDING... --replace`, or write the pose layer again, sorted by time",
)
def _time_order(view: SceneView) -> Iterator[Finding]:
    poses = view.all_poses
    stamps = poses.integers("timestamp_ns")
    step = np.diff(stamps, prepend=stamps[:1])
    yield from poses.findings(
        poses.same_file & (step <= 0), lambda row: f"{step[row]} ns after the pose before it; expected more than 0"
    )


_NUMBERS = tuple(field.name for field in EGO_POSES.schema if pa.types.is_floating(field.type))
_LIMITS = {"longitude_deg": 180.0, "latitude_deg": 90.0}


@scene_rule(
    "POS002",
    Severity.ERROR,
    title="A number of a pose is NaN or infinite, or its longitude or latitude is out of range.",
    remedy="find out why the source has no such number there, and `mirror ingest RECORDING... --replace`",
)
def _not_finite(view: SceneView) -> Iterator[Finding]:
    poses = view.all_poses
    bad = np.zeros(len(poses), np.bool_)
    for name in _NUMBERS:
        values = poses.floats(name)
        bad |= poses.is_known(name) & ~(np.isfinite(values) & (np.abs(values) <= _LIMITS.get(name, np.inf)))
    yield from poses.findings(bad, lambda row: ", ".join(f"{name} {poses.floats(name)[row]:.9g}" for name in _NUMBERS))


@scene_rule(
    "POS003",
    Severity.ERROR,
    title="A pose's quaternion is not of unit length.",
    remedy="normalise the quaternions where they come from, and write the table again",
)
def _quaternion_length(view: SceneView) -> Iterator[Finding]:
    motion = view.motion
    length = np.linalg.norm(motion.rotation, axis=1)
    bad = ~motion.unit & np.isfinite(length)
    yield from view.all_poses.findings(
        bad, lambda row: f"length {length[row]:.9g}; expected 1", worst=np.abs(length - 1.0)
    )


@scene_rule(
    "POS004",
    Severity.WARNING,
    title=("A pose's quaternion has a negative scalar part: the same rotation, but not in its canonical form."),
    remedy="change the sign of all four components, and write the table again",
)
def _quaternion_sign(view: SceneView) -> Iterator[Finding]:
    scalar = view.all_poses.floats("qw")
    yield from view.all_poses.findings(scalar < 0, lambda row: f"qw is {scalar[row]:.9g}; expected at least 0")


@scene_rule(
    "POS005",
    Severity.WARNING,
    title=("Poses are missing within a pass, for longer than the trigger's `max_gap_s`, while the vehicle moved."),
    remedy="take the poses between from another source as a pose layer, or drop the pass",
)
def _gap(view: SceneView) -> Iterator[Finding]:
    if view.dataset.document is None:
        return
    trigger = view.dataset.document.trigger
    poses, motion = view.all_poses, view.motion
    stamps = poses.integers("timestamp_ns")
    inside = (stamps > view.entry_ns[poses.traversal]) & (np.roll(stamps, 1) < view.exit_ns[poses.traversal])
    bad = inside & (motion.step_s > trigger.max_gap_s) & (motion.distance_m > trigger.min_step_m)
    yield from poses.findings(
        bad,
        lambda row: (
            f"{motion.step_s[row]:.3f} s and {motion.distance_m[row]:.1f} m after the pose before it;"
            f" expected at most {trigger.max_gap_s:g} s"
        ),
        worst=motion.step_s,
    )


@scene_rule(
    "POS006",
    Severity.WARNING,
    title="The vehicle jumps: faster from one pose to the next than cleaning allows (`max_speed_mps`).",
    remedy="check the fixes at this place; ingest again with a lower --max-speed-mps",
)
def _speed(view: SceneView) -> Iterator[Finding]:
    if view.dataset.document is None:
        return
    cleaning = view.dataset.document.cleaning
    motion = view.motion
    # What noise may do between two poses that are close in time is no speed.
    bad = view.has_motion[view.all_poses.traversal]
    bad &= motion.distance_m > cleaning.max_speed_mps * motion.step_s + cleaning.noise_m
    yield from view.all_poses.findings(
        bad,
        lambda row: (
            f"{motion.distance_m[row]:.2f} m in {motion.step_s[row]:.3f} s, {motion.speed_mps[row]:.1f} m/s;"
            f" expected at most {cleaning.max_speed_mps:g} m/s"
        ),
        worst=motion.speed_mps,
    )


_SPAN_S = 0.5


@scene_rule(
    "POS007",
    Severity.WARNING,
    title=("The velocity jumps: over half a second, more than cleaning's `max_acceleration_mps2` on the level."),
    remedy="smooth the track into a pose layer, or check the fixes for a jump",
)
def _acceleration(view: SceneView) -> Iterator[Finding]:
    if view.dataset.document is None:
        return
    limit = view.dataset.document.cleaning.max_acceleration_mps2
    found = np.where(view.has_motion[view.all_poses.traversal], accelerations(view.motion), np.nan)
    yield from view.all_poses.findings(
        found > limit,
        lambda row: f"{found[row]:.1f} m/s2; expected at most {limit:g} m/s2",
        worst=found,
    )


def accelerations(motion: MotionColumns) -> Float64:
    """Return the horizontal accelerations (N,), by second differences.

    They are over half a second to both sides, or a step if that is longer.

    A tenth of a second would turn centimetres of noise into many m/s2. NaN near the ends of a file.
    """
    poses = motion.poses
    stamps = poses.integers("timestamp_ns")
    before = motion.step_s
    after = np.append(before[1:], np.nan)
    span = np.fmax(_SPAN_S, np.fmax(before, after))
    result = np.full(len(poses), np.nan)
    for start, stop in zip(poses.starts[:-1].tolist(), poses.starts[1:].tolist()):
        own = slice(start, stop)
        if stop - start < 3 or not (before[start + 1 : stop] > 0).all():
            continue
        seconds = (stamps[own] - stamps[start]) * 1e-9
        early, late = seconds - span[own], seconds + span[own]
        whole = (early >= 0) & (late <= seconds[-1])
        total = np.zeros(stop - start)
        for axis in (0, 1):
            at = motion.position[own, axis]
            bend = np.interp(early, seconds, at) + np.interp(late, seconds, at) - 2.0 * at
            total += (bend / span[own] ** 2) ** 2
        result[own] = np.where(whole, np.sqrt(total), np.nan)
    return result


_SPAN_S = 0.2
_LIMIT_DEGPS = 120.0


@scene_rule(
    "POS008",
    Severity.WARNING,
    title="The recorded orientation jumps: over a fifth of a second, faster than 120 degrees a second.",
    remedy="find the jump of the orientation at this place, and correct it in a pose layer",
)
def _turn_rate(view: SceneView) -> Iterator[Finding]:
    poses = view.all_poses
    codes, words = poses.text_codes("orientation")
    recorded = codes == (words.index("recorded") if "recorded" in words else -2)
    rate = turn_rates(view.motion)
    yield from poses.findings(
        recorded & view.has_motion[poses.traversal] & (rate > _LIMIT_DEGPS),
        lambda row: f"{rate[row]:.0f} degrees a second; expected at most {_LIMIT_DEGPS:g}",
        worst=rate,
    )


def turn_rates(motion: MotionColumns) -> Float64:
    """Return the turn rates (N,) in degrees a second.

    They are towards the pose a fifth of a second later, or the next if that is later.
    """
    poses = motion.poses
    stamps = poses.integers("timestamp_ns")
    result = np.full(len(poses), np.nan)
    for start, stop in zip(poses.starts[:-1].tolist(), poses.starts[1:].tolist()):
        if stop - start < 2 or not (motion.step_s[start + 1 : stop] > 0).all() or not motion.unit[start:stop].all():
            continue
        seconds = (stamps[start:stop] - stamps[start]) * 1e-9
        later = np.searchsorted(seconds, seconds + _SPAN_S - 1e-9)
        here = np.flatnonzero(later < stop - start)
        rotation = quaternion_normalise(motion.rotation[start:stop])
        angle = angle_between_deg(rotation[here], rotation[later[here]])
        result[start + here] = angle / (seconds[later[here]] - seconds[here])
    return result


_LONGEST_S = 1.0
_MOVING_MPS = 3.0


_TURN_DEG = 5.0


@scene_rule(
    "POS009",
    Severity.WARNING,
    title=(
        "The position stands still for over a second, but the vehicle moves: it turns, or was too fast to stop at once."
    ),
    remedy="take the poses there from another source as a pose layer, or drop the pass",
)
def _frozen(view: SceneView) -> Iterator[Finding]:
    if view.dataset.document is None:
        return
    brake = view.dataset.document.cleaning.max_acceleration_mps2
    poses, motion = view.all_poses, view.motion
    stamps = poses.integers("timestamp_ns")
    still = poses.same_file & (motion.step_m == 0.0).all(axis=1)
    edges = np.diff(still.astype(np.int8), prepend=0, append=0)
    # A run of still steps begins behind its first pose and ends at its last.
    first, last = np.flatnonzero(edges == 1) - 1, np.flatnonzero(edges == -1) - 1
    long = (stamps[last] - stamps[first]) * 1e-9 > _LONGEST_S
    bad = np.zeros(len(poses), np.bool_)
    for begin, end in zip(first[long].tolist(), last[long].tolist()):
        into, out = begin, min(end + 1, len(poses) - 1)
        fast = any(
            motion.speed_mps[step] > max(_MOVING_MPS, brake * motion.step_s[step])
            for step in (into, out)
            if poses.same_file[step]
        )
        bad[begin] = view.has_motion[poses.traversal[begin]] and (fast or _turn_deg(motion, begin, end) > _TURN_DEG)
    length = np.zeros(len(poses))
    length[first] = (stamps[last] - stamps[first]) * 1e-9
    yield from poses.findings(
        bad,
        lambda row: f"the same position for {length[row]:.1f} s, while the vehicle turns or moves",
        worst=length,
    )


def _turn_deg(motion: MotionColumns, begin: int, end: int) -> float:
    """The angle between the first and the last orientation of a run of poses; 0 where it is not known."""
    # A course is made of positions: it says nothing of its own.
    if motion.poses.text("orientation", begin) != "recorded" or not (motion.unit[begin] and motion.unit[end]):
        return 0.0
    first, last = quaternion_normalise(motion.rotation[[begin, end]])
    return float(angle_between_deg(first, last))


@scene_rule(
    "POS010",
    Severity.ERROR,
    title="An image is earlier than the first or later than the last pose of its traversal.",
    remedy="`mirror ingest RECORDING... --replace`: an image without a pose does not belong to a pass",
)
def _cover_images(view: SceneView) -> Iterator[Finding]:
    first, last = view.pose_span()
    stamps = view.images.integers("timestamp_ns")
    number = view.images.traversal
    # Where the table of poses cannot be read, another rule says so.
    read = np.isin(number, [traversal for _, traversal, _ in view.poses.parts])
    outside_s = np.maximum(first[number] * 1e-9 - stamps * 1e-9, stamps * 1e-9 - last[number] * 1e-9)
    yield from view.images.findings(
        read & ((stamps < first[number]) | (stamps > last[number])),
        lambda row: (
            f"{outside_s[row]:.3f} s outside the poses, {first[number[row]]} to {last[number[row]]}"
            if first[number[row]] <= last[number[row]]
            else "the traversal has no poses"
        ),
        worst=outside_s,
    )


@scene_rule(
    "POS011",
    Severity.ERROR,
    title="Poses do not reach from the entry to the exit of their pass.",
    remedy="`mirror ingest RECORDING... --replace`",
)
def _cover_pass(view: SceneView) -> Iterator[Finding]:
    first, last = view.pose_span()
    for number, item in enumerate(view.traversals):
        if item.ledger_row is None or first[number] > last[number]:
            continue
        missing = max(int(first[number] - view.entry_ns[number]), int(view.exit_ns[number] - last[number]))
        if missing > 0:
            yield Finding(
                f"traversals/{item.traversal_id}/recorded/ego_poses.parquet",
                None,
                f"{missing * 1e-9:.3f} s of the pass have no poses: they run from {first[number]} to {last[number]},"
                f" the pass from {view.entry_ns[number]} to {view.exit_ns[number]}",
            )


_MARGIN_NS = 1_000_000_000


@scene_rule(
    "POS012",
    Severity.WARNING,
    title="Poses end less than a second beyond an end of the pass, though the drive goes on there.",
    remedy="`mirror ingest RECORDING... --replace`",
)
def _margin(view: SceneView) -> Iterator[Finding]:
    first, last = view.pose_span()
    for file, number, rows in view.poses.slices():
        item = view.traversals[number]
        own = view.poses.integers("timestamp_ns")[rows]
        if item.ledger_row is None or len(own) < 2:
            continue
        # The next pose may just have missed the second.
        slack = int(np.diff(own).max())
        beyond = (
            ("entry", int(view.entry_ns[number] - first[number]), int(view.entry_ns[number]) - item.drive.start_ns),
            ("exit", int(last[number] - view.exit_ns[number]), item.drive.end_ns - int(view.exit_ns[number])),
        )
        for end, there, possible in beyond:
            if item.ledger_row[f"{end}_kind"] == "crossing" and 0 <= there < min(_MARGIN_NS, possible) - slack:
                yield Finding(
                    file,
                    end,
                    f"poses reach {there * 1e-9:.3f} s beyond it, the drive {possible * 1e-9:.3f} s; expected 1 s",
                )
