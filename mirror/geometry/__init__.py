"""Poses, cameras and boxes: numpy only, batched on the leading axis, float64.

Geodesy needs pyproj and shapely: it is imported from `mirror.geometry.geodesy` by those who use it.
"""

from __future__ import annotations

from mirror.geometry.box_projection import BoxProjections, convex_hull, project_boxes
from mirror.geometry.boxes import corners, points_in_boxes
from mirror.geometry.cameras import COEFFICIENTS, Camera, Projection, Rays, camera_from_row, undistorted
from mirror.geometry.interpolation import interpolate
from mirror.geometry.poses import Poses
from mirror.geometry.quaternions import (
    angle_between_deg,
    heading_deg,
    matrix_from_quaternion,
    quaternion_exp,
    quaternion_from_heading_pitch_roll,
    quaternion_from_matrix,
    quaternion_inverse,
    quaternion_log,
    quaternion_multiply,
    quaternion_normalise,
    rotate,
    slerp,
)

__all__ = [
    "COEFFICIENTS",
    "BoxProjections",
    "Camera",
    "Poses",
    "Projection",
    "Rays",
    "angle_between_deg",
    "camera_from_row",
    "convex_hull",
    "corners",
    "heading_deg",
    "interpolate",
    "matrix_from_quaternion",
    "points_in_boxes",
    "project_boxes",
    "quaternion_exp",
    "quaternion_from_heading_pitch_roll",
    "quaternion_from_matrix",
    "quaternion_inverse",
    "quaternion_log",
    "quaternion_multiply",
    "quaternion_normalise",
    "rotate",
    "slerp",
    "undistorted",
]
