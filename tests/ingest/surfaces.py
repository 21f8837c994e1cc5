"""The surfaces that the trigger's reference works on: a plane, and the ellipsoid by Karney's geodesics."""

from __future__ import annotations

import math

import numpy as np
from pyproj import Geod

from mirror.arrays import Float64
from mirror.recordings.protocol import Track
from mirror.schema.documents import Roi

Point = tuple[float, float]
GEOD = Geod(ellps="WGS84")


class Plane:
    """A local metric frame."""

    def usable(self, p: Point) -> bool:
        return abs(p[0]) < 1e9 and abs(p[1]) < 1e9

    def distance(self, p: Point, q: Point) -> float:
        return math.hypot(p[0] - q[0], p[1] - q[1])

    def distances(self, p: Float64, q: Float64) -> Float64:
        return np.asarray(np.hypot(*(p - q).T))

    def between(self, p: Point, q: Point, share: float) -> Point:
        return p[0] + share * (q[0] - p[0]), p[1] + share * (q[1] - p[1])

    def course(self, p: Point, q: Point) -> float:
        return math.degrees(math.atan2(q[0] - p[0], q[1] - p[1])) % 360.0


class Globe:
    """The ellipsoid; motion is linear in longitude and latitude, the short way round."""

    def usable(self, p: Point) -> bool:
        return abs(p[0]) <= 180.0 and abs(p[1]) <= 90.0

    def distance(self, p: Point, q: Point) -> float:
        metres: float = GEOD.inv(p[0], p[1], q[0], q[1])[2]
        return metres

    def distances(self, p: Float64, q: Float64) -> Float64:
        p, q = np.broadcast_arrays(p, q)
        return np.asarray(GEOD.inv(p[:, 0], p[:, 1], q[:, 0], q[:, 1])[2])

    def between(self, p: Point, q: Point, share: float) -> Point:
        turn = (q[0] - p[0] + 540.0) % 360.0 - 180.0
        return p[0] + share * turn, p[1] + share * (q[1] - p[1])

    def course(self, p: Point, q: Point) -> float:
        there, back, _ = GEOD.inv(p[0], p[1], q[0], q[1])
        bend = (back + 180.0 - there + 180.0) % 360.0 - 180.0
        middle: float = (there + 0.5 * bend) % 360.0
        return middle


Surface = Plane | Globe


def surface_of(track: Track) -> tuple[Surface, list[Point]]:
    if track.longitude_deg is not None:
        assert track.latitude_deg is not None
        return Globe(), list(zip(track.longitude_deg.tolist(), track.latitude_deg.tolist()))
    assert track.x_m is not None
    assert track.y_m is not None
    return Plane(), list(zip(track.x_m.tolist(), track.y_m.tolist()))


def centre_of(roi: Roi) -> Point:
    """The centre in the coordinates of its frame."""
    centre = (roi.longitude_deg, roi.latitude_deg) if roi.frame is None else (roi.x_m, roi.y_m)
    assert centre[0] is not None
    assert centre[1] is not None
    return centre[0], centre[1]
