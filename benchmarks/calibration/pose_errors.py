"""``python -m benchmarks calibration poses``: `mirror poses` on a synthetic drive, against its exact poses.

The drive of the preset ``calibration``: a bend of 152 m by day, seven cameras of 480 px at 2 Hz, recorded errors of
lenses and mountings. The images of one camera are registered; scale and world come from the other cameras, from the
track, or from the height of the camera. Errors are those of the camera's poses after one rigid motion and a scale: of
places in percent of the way, of rotations in degrees after the rotation that fits all rotations best. Places on a bend
hold the roll about the way weakly, so that the rotation that fits the places best leaves more; both are printed. The
error of the scale stands apart.
"""

from __future__ import annotations

import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.calibration.verbs import run_verb
from benchmarks.report import Row
from mirror.arrays import Float64
from mirror.geometry import Poses, matrix_from_quaternion, quaternion_from_matrix, quaternion_log
from mirror.geometry.geodesy import TangentFrame
from mirror.geometry.poses import COLUMNS
from mirror.recordings.protocol import Recording
from mirror.recordings.registry import open_recording
from mirror.synth.fleet.drives import make_drive

SCALES: Final = ("rig", "track", "height")
CAMERA: Final = "front_wide"
_PRESET: Final = "calibration"
_RANK: Final = ("factory", "online", "refined")
_WAY_PERCENT: Final = 0.5
_TURN_DEG: Final = 0.1
_SCALE_PERCENT: Final = {"rig": 1.0, "track": 1.0, "height": 3.0}


@dataclass(frozen=True)
class PoseErrors:
    """Errors of the poses of a camera after one similarity.

    Attributes:
        way_percent: root mean square of the places, percent of the way.
        turn_deg: median of the rotations, after the rotation that fits them best.
        by_places_deg: median of the rotations, after the rotation that fits the places best.
        apart_deg: angle between these two rotations.
        scale_percent: error of the scale.
        count: number of poses.
    """

    way_percent: float
    turn_deg: float
    by_places_deg: float
    apart_deg: float
    scale_percent: float
    count: int


def pose_rows(folder: Path, scales: Sequence[str] = SCALES) -> Iterator[Row]:
    """Yield the errors for each source of the scale.

    Args:
        folder: working folder; the recording in it is kept.
        scales: values of ``mirror poses --scale``.
    """
    recordings = folder / "recordings"
    if not (recordings / "rois.geojson").is_file():
        run_verb("synth", "--preset", _PRESET, "--out", recordings, "--workers", 1)
    (source,) = (path.parent for path in recordings.glob("*/recording.json"))
    for scale in scales:
        out = folder / f"posed-{scale}"
        shutil.rmtree(out, ignore_errors=True)
        start = time.process_time()
        run_verb("poses", source, "--camera", CAMERA, "--scale", scale, "--out", out, partly=True)
        spent_ms = (time.process_time() - start) * 1e3
        errors = measure(open_recording(out), source.name)
        size = f"{errors.count} images"
        yield Row(f"{scale}: places, rms (% of the way)", size, errors.way_percent, bar=_WAY_PERCENT)
        yield Row(f"{scale}: rotations, median (deg)", size, errors.turn_deg, errors.by_places_deg,
                  unit=f"deg by places, {errors.apart_deg:.3f} apart", bar=_TURN_DEG)  # fmt: skip
        yield Row(f"{scale}: scale (%)", size, abs(errors.scale_percent), bar=_SCALE_PERCENT[scale])
        yield Row(f"{scale}: processor time (ms)", size, spent_ms)


def measure(found: Recording, drive: str) -> PoseErrors:
    """Compare the poses of a recording with those of the synthetic drive.

    Args:
        found: the recording that `mirror poses` wrote.
        drive: id of the drive.
    """
    stamps, poses = _camera_poses(found)
    true = make_drive(_PRESET, 0, drive).world_SE3_camera(CAMERA, stamps)
    here, there = (one.translation - one.translation.mean(axis=0) for one in (poses, true))
    left, sizes, right = np.linalg.svd(there.T @ here)
    sign = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    turn = left @ sign @ right
    scale = float((sizes * np.diag(sign)).sum() / (here**2).sum())
    way = float(np.linalg.norm(np.diff(there, axis=0), axis=1).sum())
    off = np.linalg.norm(scale * here @ turn.T - there, axis=1)
    exact, mine = matrix_from_quaternion(true.rotation), matrix_from_quaternion(poses.rotation)
    back = np.swapaxes(exact, 1, 2)
    best = _mean_rotation(exact @ np.swapaxes(mine, 1, 2))
    return PoseErrors(
        100.0 * float(np.sqrt((off**2).mean())) / way,
        float(np.median(_angles_deg(back @ best @ mine))),
        float(np.median(_angles_deg(back @ turn @ mine))),
        float(_angles_deg((turn.T @ best)[None])[0]),
        100.0 * (1.0 / scale - 1.0),
        len(stamps),
    )


def _camera_poses(found: Recording) -> tuple[np.ndarray, Poses]:
    """Stamps and poses of the camera in a metric frame, by its best recorded mounting."""
    track = found.track()
    if track.rotation is None or track.height_m is None:
        raise ValueError("the recording has no rotations")
    turns = matrix_from_quaternion(track.rotation)
    if track.longitude_deg is not None and track.latitude_deg is not None:
        frame = TangentFrame(track.longitude_deg[0], track.latitude_deg[0], track.height_m[0])
        places = frame.from_geodetic(track.longitude_deg, track.latitude_deg, track.height_m)
        turns = frame.world_R_enu(track.longitude_deg, track.latitude_deg) @ turns
    else:
        places = np.column_stack([np.asarray(track.x_m), np.asarray(track.y_m), track.height_m])
    rows = [row for row in found.calibrations().to_pylist() if row["camera"] == CAMERA]
    best = max(rows, key=lambda row: _RANK.index(row["stage"]))
    mounting = Poses.from_columns({name: np.full(len(track), best[name]) for name in COLUMNS})
    return track.timestamp_ns, Poses(quaternion_from_matrix(turns), places) @ mounting


def _mean_rotation(turns: Float64) -> Float64:
    left, _, right = np.linalg.svd(turns.sum(axis=0))
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right, np.float64)


def _angles_deg(turns: Float64) -> Float64:
    return np.asarray(np.degrees(np.linalg.norm(quaternion_log(quaternion_from_matrix(turns)), axis=1)), np.float64)
