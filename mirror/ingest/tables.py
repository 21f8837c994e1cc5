"""The rows that ingest writes: poses in the scene's world, frames of a rig, and the ledger."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pyarrow as pa

from mirror.arrays import Float64, Int64
from mirror.errors import MirrorError, RecordingError
from mirror.geometry.geodesy import TangentFrame
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import (
    quaternion_from_heading_pitch_roll,
    quaternion_from_matrix,
    quaternion_multiply,
)
from mirror.ingest.metric import scales
from mirror.ingest.passes import DrivePasses, PoseSlice
from mirror.recordings.light import light_label, solar_elevation_deg
from mirror.schema.documents import Roi
from mirror.schema.files import conform
from mirror.schema.tables import EGO_POSES, PASSES

_COURSE_STEP_M = 0.5


def build_pose_table(poses: PoseSlice, roi: Roi, drive: DrivePasses) -> pa.Table:
    """Return ``ego_poses`` of one traversal, in the world of its scene.

    The world is the east-north-up frame at the ROI's centre; of a drive in a local metric frame it is that frame. Where
    the source has no height, the ROI's is taken; where it has no orientation, the direction of travel, level.

    Raises:
        RecordingError: a quaternion or height is not finite, or zero.
    """
    count = len(poses.timestamp_ns)
    recorded = poses.rotation is not None
    rotation = poses.rotation if poses.rotation is not None else course(poses, geodetic=roi.frame is None)
    longitude: Float64 | None = None
    latitude: Float64 | None = None
    if roi.longitude_deg is not None and roi.latitude_deg is not None:
        longitude, latitude = poses.lon_or_x, poses.lat_or_y
        world = TangentFrame(roi.longitude_deg, roi.latitude_deg, roi.height_m)
        height = np.full(count, roi.height_m) if poses.height_m is None else poses.height_m
        translation = world.from_geodetic(longitude, latitude, height)
        turn = quaternion_from_matrix(world.world_R_enu(longitude, latitude))
    else:
        height = np.zeros(count) if poses.height_m is None else poses.height_m
        translation = np.column_stack([poses.lon_or_x, poses.lat_or_y, height])
        turn = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    try:
        world_SE3_ego = Poses(quaternion_multiply(turn, Poses(rotation, translation).rotation), translation)
    except MirrorError as error:
        raise RecordingError(
            error.problem,
            file=drive.recording.track().file or drive.path,
            place=f"{error.place} of the pass at {poses.timestamp_ns[0]}",
            expected=error.expected,
            remedy=error.remedy,
        ) from error
    q, t = world_SE3_ego.rotation, world_SE3_ego.translation
    nothing = pa.nulls(count, pa.float64())
    columns = {
        "timestamp_ns": poses.timestamp_ns,
        **{name: q[:, axis] for axis, name in enumerate(("qw", "qx", "qy", "qz"))},
        **{name: t[:, axis] for axis, name in enumerate(("tx_m", "ty_m", "tz_m"))},
        "longitude_deg": nothing if longitude is None else longitude,
        "latitude_deg": nothing if latitude is None else latitude,
        "height_m": nothing if poses.height_m is None or longitude is None else poses.height_m,
        "sigma_m": nothing if poses.sigma_m is None else pa.array(poses.sigma_m, from_pandas=True),
        "orientation": pa.array(["recorded" if recorded else "course"] * count),
    }
    return conform(pa.table(columns), EGO_POSES, file=EGO_POSES.place)


def course(poses: PoseSlice, *, geodetic: bool) -> Float64:
    """Compute level rotations along the direction of travel, from positions alone.

    A step counts once it is half a metre long; between the middles of such steps the course turns evenly, so that it is
    held while standing.

    Returns:
        (N, 4) unit quaternions, ``enu_SE3_ego`` (local frame: ``frame_SE3_ego``).
    """
    count = len(poses.timestamp_ns)
    if count == 0:
        return np.empty((0, 4))
    scale_x, scale_y = scales(float(poses.lat_or_y[0]), geodetic)
    x, y = (poses.lon_or_x - poses.lon_or_x[0]) * scale_x, (poses.lat_or_y - poses.lat_or_y[0]) * scale_y
    seconds = (poses.timestamp_ns - poses.timestamp_ns[0]) * 1e-9
    times, angles = [], []
    last = 0
    for index in range(1, count):
        dx, dy = x[index] - x[last], y[index] - y[last]
        if dx * dx + dy * dy >= _COURSE_STEP_M**2:
            times.append(0.5 * (seconds[max(last, index - 1)] + seconds[index]))
            angles.append(np.arctan2(dx, dy))
            last = index
    heading = np.interp(seconds, times, np.unwrap(angles)) if angles else np.zeros(count)
    return quaternion_from_heading_pitch_roll(np.degrees(heading))


def assign_frames(mid_ns: Mapping[str, Int64], reference: str) -> dict[str, list[int | None]]:
    """Assign each image to a frame.

    A frame is an exposure of the reference camera; of every other camera it takes the image nearest in time, if that
    is within half a period and has no nearer frame.

    Args:
        mid_ns: strictly increasing mid-exposure stamps by camera.
        reference: the reference camera.

    Returns:
        Frame indices by camera; None where an image belongs to no frame.
    """
    frames = mid_ns.get(reference, np.empty(0, np.int64))
    if not len(frames):
        return {camera: [None] * len(stamps) for camera, stamps in mid_ns.items()}
    steps = [np.diff(stamps) for stamps in mid_ns.values() if len(stamps) > 1]
    period = np.median(np.diff(frames)) if len(frames) > 1 else np.median(np.concatenate(steps)) if steps else 0
    assigned: dict[str, list[int | None]] = {}
    for camera, stamps in mid_ns.items():
        frame = _nearest(frames, stamps)
        image = _nearest(stamps, frames)
        mutual = image[frame] == np.arange(len(stamps)) if len(stamps) else np.empty(0, bool)
        near = np.abs(frames[frame] - stamps) * 2 <= period
        belongs = mutual & near if camera != reference else np.ones(len(stamps), bool)
        assigned[camera] = [int(index) if yes else None for index, yes in zip(frame, belongs)]
    return assigned


def _nearest(sorted_ns: Int64, query_ns: Int64) -> Int64:
    """Index of the nearest of the sorted stamps for each query; the earlier one of two at equal distance."""
    if not len(sorted_ns):
        return np.zeros(len(query_ns), np.int64)
    right = np.clip(np.searchsorted(sorted_ns, query_ns), 1, max(len(sorted_ns) - 1, 1))
    if len(sorted_ns) == 1:
        return np.zeros(len(query_ns), np.int64)
    left = right - 1
    return np.where(query_ns - sorted_ns[left] <= sorted_ns[right] - query_ns, left, right)


def build_pass_table(
    drive: DrivePasses, traversal_ids: Sequence[str | None], weather: Mapping[int, str], weather_plugin: str | None
) -> pa.Table:
    """Return the ledger of one drive.

    Args:
        drive: judged.
        traversal_ids: one for each pass, None for the refused.
        weather: by number of pass, if a plug-in stated it.
        weather_plugin: that plug-in.
    """
    light, light_source = [], []
    for one in drive.passes:
        if drive.info.light is not None:
            light.append(drive.info.light)
            light_source.append("metadata")
        elif drive.info.frame is None and drive.info.has_date:
            light.append(light_label(float(solar_elevation_deg(one.entry_ns, *one.entry))))
            light_source.append("solar_elevation")
        else:
            light.append("unknown")
            light_source.append("unknown")
    passes, count = drive.passes, len(drive.passes)
    stated = drive.info.weather
    source = "metadata" if stated else "unknown"
    columns: dict[str, object] = {
        "scene_id": [one.scene_id for one in passes],
        "drive_id": [drive.info.drive_id] * count,
        "traversal_id": pa.array(traversal_ids, pa.string()),
        "decision": ["accepted" if one.accepted else "refused" for one in passes],
        "rule": pa.array([one.rule for one in passes], pa.string()),
        "light": light,
        "light_source": light_source,
        "weather": [weather.get(number, stated or "unknown") for number in range(count)],
        "weather_source": [weather_plugin if number in weather else source for number in range(count)],
    }
    for field in PASSES.schema:
        if field.name not in columns:
            kind = pa.string() if pa.types.is_dictionary(field.type) else field.type
            columns[field.name] = pa.array([getattr(one, field.name) for one in passes], kind)
    order = sorted(range(count), key=lambda row: (passes[row].scene_id, passes[row].entry_ns))
    arrays = {
        name: pa.array(column, pa.string()) if isinstance(column, list) else column for name, column in columns.items()
    }
    return conform(pa.table(arrays).take(pa.array(order, pa.int64())), PASSES, file=PASSES.place)
