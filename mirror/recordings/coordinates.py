"""Converts poses from the frames that recordings use (UTM, ECEF, another body) to those of a `Track`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mirror.arrays import Bool, Float64, Int64
from mirror.errors import RecordingError
from mirror.geometry.geodesy import (
    UTM_EASTING_M,
    UTM_NORTHING_M,
    TangentFrame,
    ecef_R_enu,
    ecef_to_geodetic,
    geodetic_to_ecef,
    is_in_utm_domain,
    utm_convergence_rad,
    utm_to_geodetic,
)
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import (
    quaternion_exp,
    quaternion_from_matrix,
    quaternion_inverse,
    quaternion_multiply,
    quaternion_normalise,
    rotate,
)
from mirror.recordings.protocol import Track
from mirror.recordings.row_faults import RowFaults
from mirror.recordings.tabular import RecordingRows

# Rotations of flu_SE3_frd and flu_SE3_camera. flu: x forward, y left, z up; frd: x forward, y right, z down; camera: x
# right, y down, z forward.
FLU_FROM_FRD = np.array([0.0, 1.0, 0.0, 0.0])
FLU_FROM_CAMERA = np.array([0.5, -0.5, 0.5, -0.5])

Locate = Callable[[int], tuple[Path | None, str]]
"""The file and the place in it of a row."""

# The ellipsoid's radii are 6,357 and 6,378 km; no road is 20 km above or below it.
_ECEF_RADIUS_M = (6_337_000.0, 6_398_000.0)

# Files round their quaternions; a larger deviation from unit length has another cause.
UNIT_TOLERANCE = 1e-2


def is_invalid_rotation(quaternion: Float64) -> Bool:
    """Mark which quaternions (N, 4) are NaN, zero, or off unit length by more than `UNIT_TOLERANCE`."""
    squared = np.einsum("ij,ij->i", quaternion, quaternion)
    return ~((squared >= (1.0 - UNIT_TOLERANCE) ** 2) & (squared <= (1.0 + UNIT_TOLERANCE) ** 2))


def mark_invalid_rotations(quaternion: Float64) -> tuple[Float64, Bool]:
    """Normalise quaternions as read from a file, and mark those that are not rotations.

    Args:
        quaternion: (N, 4) scalar first.

    Returns:
        (N, 4) canonical unit quaternions, the identity in marked rows; and (N,) True where `is_invalid_rotation` is.
    """
    bad = is_invalid_rotation(quaternion)
    return quaternion_normalise(np.where(bad[:, None], (1.0, 0.0, 0.0, 0.0), quaternion)), bad


def normalise_rotations(quaternion: Float64, rows: RecordingRows, column: str) -> Float64:
    """Normalise the quaternions of a table, and mark the rows with invalid ones.

    Args:
        quaternion: (N, 4) scalar first, as read.
        rows: the table.
        column: the first of the quaternion's columns, for messages.

    Returns:
        (N, 4) canonical unit quaternions; the identity in marked rows.

    Raises:
        RecordingError: a quaternion is NaN, zero, or off unit length by over 1 %, and the table does not mark bad rows;
            the row is named.
    """
    unit, bad = mark_invalid_rotations(quaternion)
    rows.refuse(
        bad,
        column,
        lambda row: f"{quaternion[row].tolist()} is no rotation",
        expected="a unit quaternion, scalar first",
        remedy="remove the row, or leave the orientation columns out of the whole drive",
        reason="rotation",
    )
    return unit


def track_from_utm(
    timestamp_ns: Int64,
    easting_m: Float64,
    northing_m: Float64,
    height_m: Float64 | None,
    grid_rotation: Float64 | None,
    *,
    zone: int,
    north: bool,
    sigma_m: Float64 | None = None,
    file: Path | None = None,
    faults: RowFaults | None = None,
    locate: Locate | None = None,
) -> Track:
    """Make a WGS 84 track from UTM coordinates; rotations are converted from grid north to true north.

    Rows outside the domain of UTM are marked in ``faults``; they have no false easting or northing, or wrong digits.

    Args:
        timestamp_ns: (N,) Unix time, UTC.
        easting_m: (N,).
        northing_m: (N,).
        height_m: (N,) above the ellipsoid, or None.
        grid_rotation: (N, 4) ``grid_SE3_ego`` with axes grid east, grid north, up, or None.
        zone: UTM zone, 1 to 60.
        north: True on the northern hemisphere.
        sigma_m: (N,) or None.
        file: the file that the poses come from.
        faults: of the N rows; None: every row is needed.
        locate: gives the file and the place of a row, for messages; None: the file and the row's number.

    Raises:
        RecordingError: a row is outside the domain of UTM, and there are no ``faults``.
    """
    place = locate or (lambda row: (file, f"row {row}"))
    missing = np.isnan(easting_m) | np.isnan(northing_m)
    outside = ~missing & ~is_in_utm_domain(easting_m, northing_m, north)
    _mark_positions(outside, faults, lambda row: _outside_utm(easting_m[row], northing_m[row], north, *place(row)))
    lon, lat = utm_to_geodetic(easting_m, northing_m, zone, north)
    rotation = None
    if grid_rotation is not None:
        # The convergence is NaN where the position is; cleaning drops those poses.
        convergence = np.nan_to_num(utm_convergence_rad(lon, lat, zone, north), posinf=0.0, neginf=0.0)
        rotation = quaternion_multiply(quaternion_exp(np.outer(-convergence, (0.0, 0.0, 1.0))), grid_rotation)
    return Track(
        timestamp_ns,
        longitude_deg=lon,
        latitude_deg=lat,
        height_m=height_m,
        rotation=rotation,
        sigma_m=sigma_m,
        file=file,
    )


def _mark_positions(bad: Bool, faults: RowFaults | None, error: Callable[[int], RecordingError]) -> None:
    if faults is not None:
        faults.add(bad, "position", error)
    elif bad.any():
        raise error(int(np.argmax(bad)))


def _outside_utm(easting_m: float, northing_m: float, north: bool, file: Path | None, place: str) -> RecordingError:
    low, high = UTM_NORTHING_M[north]
    return RecordingError(
        f"easting {easting_m:.10g} m, northing {northing_m:.10g} m is no place of a UTM zone in the"
        f" {'north' if north else 'south'}",
        file=file,
        place=place,
        expected=f"easting {UTM_EASTING_M[0]:.0f} to {UTM_EASTING_M[1]:.0f} m with the false easting of 500000 m,"
        f" northing {low:.0f} to {high:.0f} m" + ("" if north else " with the false northing of 10000000 m"),
        remedy="correct or remove the row",
    )


def track_from_ecef(
    timestamp_ns: Int64,
    position_m: Float64,
    rotation: Float64 | None,
    *,
    sigma_m: Float64 | None = None,
    file: Path | None = None,
    faults: RowFaults | None = None,
    locate: Locate | None = None,
) -> Track:
    """Make a WGS 84 track from earth-centred, earth-fixed poses.

    Rows far from the ellipsoid are marked in ``faults``: an origin in place of a position, or another unit.

    Args:
        timestamp_ns: (N,) Unix time, UTC.
        position_m: (N, 3) ECEF.
        rotation: (N, 4) ``ecef_SE3_ego``, or None.
        sigma_m: (N,) or None.
        file: the file that the poses come from.
        faults: of the N rows; None: every row is needed.
        locate: gives the file and the place of a row, for messages; None: the file and the row's number.

    Raises:
        RecordingError: a row is far from the ellipsoid, and there are no ``faults``.
    """
    radius_m = np.linalg.norm(position_m, axis=1)
    outside = ~np.isnan(radius_m) & ~((radius_m > _ECEF_RADIUS_M[0]) & (radius_m < _ECEF_RADIUS_M[1]))

    def error(row: int) -> RecordingError:
        where, place = locate(row) if locate is not None else (file, f"row {row}")
        return RecordingError(
            f"{position_m[row].tolist()} m is {radius_m[row] / 1e3:,.0f} km from the earth's centre",
            file=where,
            place=place,
            expected=f"{_ECEF_RADIUS_M[0] / 1e3:,.0f} to {_ECEF_RADIUS_M[1] / 1e3:,.0f} km, as on the ground",
            remedy="correct or remove the row",
        )

    _mark_positions(outside, faults, error)
    position_m = np.where(outside[:, None], np.nan, position_m)
    lon, lat, height = ecef_to_geodetic(position_m)
    enu = None if rotation is None else quaternion_multiply(quaternion_inverse(_ecef_from_enu(lon, lat)), rotation)
    return Track(
        timestamp_ns, longitude_deg=lon, latitude_deg=lat, height_m=height, rotation=enu, sigma_m=sigma_m, file=file
    )


def track_from_tangent(
    timestamp_ns: Int64,
    position_m: Float64,
    rotation: Float64 | None,
    frame: TangentFrame,
    *,
    file: Path | None = None,
) -> Track:
    """Make a WGS 84 track from poses in an east-north-up tangent frame.

    Args:
        timestamp_ns: (N,) Unix time, UTC.
        position_m: (N, 3) east, north and up of the frame's origin.
        rotation: (N, 4) ``frame_SE3_ego``, or None.
        frame: the place where the frame touches the ellipsoid, or lies above it.
        file: the file that the poses come from.
    """
    lon, lat, height = frame.to_geodetic(position_m)
    enu = None
    if rotation is not None:
        turn = quaternion_from_matrix(frame.world_R_enu(np.nan_to_num(lon), np.nan_to_num(lat)))
        enu = quaternion_multiply(quaternion_inverse(turn), rotation)
    return Track(timestamp_ns, longitude_deg=lon, latitude_deg=lat, height_m=height, rotation=enu, file=file)


def to_ego_track(body: Track, ego_SE3_body: Poses) -> Track:
    """Convert the track of a body to the track of the ego.

    Args:
        body: poses of the recorded body in place of the ego.
        ego_SE3_body: the pose of the body in the ego frame; one pose.

    Raises:
        RecordingError: the body is not at the ego's origin, but the track has no orientation for the offset.
    """
    body_SE3_ego = ego_SE3_body.inverse()
    offset = body_SE3_ego.translation[0]
    if body.rotation is None:
        if offset.any():
            raise RecordingError(
                f"ego_SE3_body moves by {np.linalg.norm(offset):.2f} m, but the poses have no orientation",
                file=body.file,
                expected="orientation columns",
                remedy="add them, or leave ego_SE3_body out and name the body in body_frame",
            )
        return body
    rotation = quaternion_multiply(body.rotation, body_SE3_ego.rotation)
    shift = rotate(body.rotation, offset)
    if body.x_m is not None and body.y_m is not None:
        height = None if body.height_m is None else body.height_m + shift[:, 2]
        return _move_track(body, rotation, height, x_m=body.x_m + shift[:, 0], y_m=body.y_m + shift[:, 1])
    lon, lat = np.asarray(body.longitude_deg), np.asarray(body.latitude_deg)
    known = np.zeros(len(body)) if body.height_m is None else body.height_m
    position = geodetic_to_ecef(lon, lat, known) + rotate(_ecef_from_enu(lon, lat), shift)
    # Without a height the shift is made on the ellipsoid: at a true height of 1 km, a shift of 10 m is then 2 mm off.
    lon, lat, height = ecef_to_geodetic(position)
    return _move_track(body, rotation, None if body.height_m is None else height, longitude_deg=lon, latitude_deg=lat)


def _ecef_from_enu(longitude_deg: Float64, latitude_deg: Float64) -> Float64:
    # Poses without a position get a finite rotation; cleaning drops them.
    return quaternion_from_matrix(ecef_R_enu(np.nan_to_num(longitude_deg), np.nan_to_num(latitude_deg)))


def _move_track(body: Track, rotation: Float64, height_m: Float64 | None, **position: Any) -> Track:
    return Track(
        body.timestamp_ns,
        height_m=height_m,
        rotation=rotation,
        sigma_m=body.sigma_m,
        file=body.file,
        **position,
    )
