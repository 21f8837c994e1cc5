"""From the frames that recordings use (UTM grid, ECEF, local metres, another body) to the frames of a `Track`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mirror.arrays import Bool, Float64, Int64
from mirror.errors import RecordingError
from mirror.geometry.geodesy import (
    ecef_R_enu,
    ecef_to_geodetic,
    geodetic_to_ecef,
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
from mirror.recordings.tabular import RecordingRows

# flu_SE3_frd and flu_SE3_camera: bodies whose axes are forward-right-down, or a camera's right-down-forward.
FLU_FROM_FRD = np.array([0.0, 1.0, 0.0, 0.0])
FLU_FROM_CAMERA = np.array([0.5, -0.5, 0.5, -0.5])

# Files round quaternions; anything further off unit length is something else.
UNIT_TOLERANCE = 1e-2


def is_invalid_rotation(quaternion: Float64) -> Bool:
    """Which (N,) of (N, 4) quaternions are NaN, zero, or off unit length by over `UNIT_TOLERANCE`."""
    squared = np.einsum("ij,ij->i", quaternion, quaternion)
    return ~((squared >= (1.0 - UNIT_TOLERANCE) ** 2) & (squared <= (1.0 + UNIT_TOLERANCE) ** 2))


def normalise_rotations(quaternion: Float64, rows: RecordingRows, column: str) -> Float64:
    """Unit quaternions of a table, canonical; the identity in rows that are marked as bad.

    Args:
        quaternion: (N, 4) scalar first, as read.
        rows: the table.
        column: its first column.

    Raises:
        RecordingError: one is NaN, zero, or off unit length by over 1 %, and bad rows are not marked; its row is named.
    """
    bad = is_invalid_rotation(quaternion)
    rows.refuse(
        bad,
        column,
        lambda row: f"{quaternion[row].tolist()} is no rotation",
        expected="a unit quaternion, scalar first",
        remedy="remove the row, or leave the orientation columns out of the whole drive",
        reason="rotation",
    )
    return quaternion_normalise(np.where(bad[:, None], (1.0, 0.0, 0.0, 0.0), quaternion))


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
) -> Track:
    """A track on WGS 84 of UTM coordinates; rotations turn from grid north to true north.

    Args:
        timestamp_ns: (N,) Unix time, UTC.
        easting_m: (N,).
        northing_m: (N,).
        height_m: (N,) above the ellipsoid, or None.
        grid_rotation: (N, 4) ``grid_SE3_ego`` with axes grid east, grid north, up, or None.
        zone: UTM zone.
        north: hemisphere.
        sigma_m: (N,) or None.
        file: the file the poses came from.
    """
    lon, lat = utm_to_geodetic(easting_m, northing_m, zone, north)
    rotation = None
    if grid_rotation is not None:
        # Where there is no position there is no convergence, and cleaning will drop the pose.
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


def track_from_ecef(
    timestamp_ns: Int64,
    position_m: Float64,
    rotation: Float64 | None,
    *,
    sigma_m: Float64 | None = None,
    file: Path | None = None,
) -> Track:
    """A track on WGS 84 of earth-centred, earth-fixed poses.

    Args:
        timestamp_ns: (N,) Unix time, UTC.
        position_m: (N, 3) ECEF.
        rotation: (N, 4) ``ecef_SE3_ego``, or None.
        sigma_m: (N,) or None.
        file: the file the poses came from.
    """
    lon, lat, height = ecef_to_geodetic(position_m)
    enu = None if rotation is None else quaternion_multiply(quaternion_inverse(_ecef_from_enu(lon, lat)), rotation)
    return Track(
        timestamp_ns, longitude_deg=lon, latitude_deg=lat, height_m=height, rotation=enu, sigma_m=sigma_m, file=file
    )


def to_ego_track(body: Track, ego_SE3_body: Poses) -> Track:
    """The ego's track of a body's, whose place in the ego frame is known.

    Args:
        body: poses of the recorded body, as if it were the ego.
        ego_SE3_body: one pose.

    Raises:
        RecordingError: the body is elsewhere, but the track has no orientation to say in which direction.
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
        return _moved(body, rotation, height, x_m=body.x_m + shift[:, 0], y_m=body.y_m + shift[:, 1])
    lon, lat = np.asarray(body.longitude_deg), np.asarray(body.latitude_deg)
    known = np.zeros(len(body)) if body.height_m is None else body.height_m
    position = geodetic_to_ecef(lon, lat, known) + rotate(_ecef_from_enu(lon, lat), shift)
    # Without a height the shift is made on the ellipsoid: at a true height of 1 km 10 m are then 2 mm off.
    lon, lat, height = ecef_to_geodetic(position)
    return _moved(body, rotation, None if body.height_m is None else height, longitude_deg=lon, latitude_deg=lat)


def _ecef_from_enu(longitude_deg: Float64, latitude_deg: Float64) -> Float64:
    # Poses without a position keep a rotation that is finite, and are dropped by cleaning.
    return quaternion_from_matrix(ecef_R_enu(np.nan_to_num(longitude_deg), np.nan_to_num(latitude_deg)))


def _moved(body: Track, rotation: Float64, height_m: Float64 | None, **position: Any) -> Track:
    return Track(
        body.timestamp_ns,
        height_m=height_m,
        rotation=rotation,
        sigma_m=body.sigma_m,
        file=body.file,
        **position,
    )
