"""Calibrations of recordings, and their rows of the `calibrations` table."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import numpy as np
import pyarrow as pa
from pydantic import Field, ValidationError, model_validator

from mirror.arrays import Float64
from mirror.errors import RecordingError, UsageError
from mirror.geometry.cameras.camera import Camera, camera_from_attributes
from mirror.geometry.quaternions import quaternion_normalise
from mirror.recordings.coordinates import UNIT_TOLERANCE
from mirror.schema.documents import Document
from mirror.schema.problems import describe_problem_and_value
from mirror.schema.tables import CALIBRATIONS

Stage = Literal["factory", "online", "refined"]
STAGES: tuple[Stage, ...] = ("factory", "online", "refined")
Finite = Annotated[float, Field(allow_inf_nan=False)]
Pixels = Annotated[int, Field(gt=0, lt=2**31)]
Nanoseconds = Annotated[int, Field(gt=-(2**63), lt=2**63)]
COVARIANCE_TOLERANCE: Final = 1e-3
SE3 = Annotated[tuple[Finite, ...], Field(min_length=7, max_length=7)]


class Calibration(Document):
    """One camera's intrinsics and mounting over a validity interval; docs/schema.md describes the table.

    Attributes:
        camera: the camera's name.
        model: the camera model that the coefficients belong to.
        width_px: width of the calibrated raster.
        height_px: height of the calibrated raster.
        fx_px: focal length in x.
        fy_px: focal length in y.
        cx_px: x of the principal point; the centre of the first pixel is at 0.5.
        cy_px: y of the principal point.
        distortion: coefficients in the order of the model.
        ego_SE3_camera: ``qw qx qy qz tx_m ty_m tz_m``.
        valid_from_ns: Unix time; None: valid from the beginning.
        valid_to_ns: Unix time; None: valid without end.
        time_offset_ns: the offset that was added to the camera's own stamps.
        shutter_direction: the direction in which rows or columns are exposed one after the other.
        readout_ns: time from the start of the first row's exposure to the start of the last row's.
        covariance: 6x6 row-major, of the mounting: rotation (rad), then translation (m); symmetric and positive
            semi-definite within `COVARIANCE_TOLERANCE` of its correlations.
        method: how it was obtained.
    """

    camera: str
    model: str
    width_px: Pixels
    height_px: Pixels
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = ()
    ego_SE3_camera: SE3
    valid_from_ns: Nanoseconds | None = None
    valid_to_ns: Nanoseconds | None = None
    time_offset_ns: Nanoseconds = 0
    shutter_direction: Literal["global", "top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left"] = "global"
    readout_ns: Annotated[Nanoseconds, Field(ge=0)] = 0
    covariance: Annotated[tuple[Finite, ...], Field(min_length=36, max_length=36)] | None = None
    method: str | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Calibration:
        try:
            camera_from_attributes(self)
        except UsageError as error:
            raise ValueError(str(error)) from error
        length = float(np.linalg.norm(self.ego_SE3_camera[:4]))
        if abs(length - 1.0) > UNIT_TOLERANCE:
            raise ValueError(f"the quaternion of ego_SE3_camera has length {length:.4g}, not 1")
        if self.covariance is not None:
            require_covariance(np.array(self.covariance))
        if self.valid_from_ns is not None and self.valid_to_ns is not None and self.valid_from_ns > self.valid_to_ns:
            raise ValueError("valid_from_ns lies after valid_to_ns")
        return self


def require_covariance(covariance: Float64) -> None:
    """Raise an error unless 36 row-major values are a 6x6 covariance.

    The tolerance allows for values that were rounded to four digits.

    Raises:
        ValueError: a value is not finite, or the correlations (covariances over standard deviations) are not symmetric
            or not positive semi-definite within `COVARIANCE_TOLERANCE`.
    """
    if covariance.size != 36:
        raise ValueError(f"the covariance has {covariance.size} values, not 36")
    covariance = covariance.reshape(6, 6)
    if not np.isfinite(covariance).all():
        raise ValueError("the covariance is not finite")
    variance = np.diag(covariance)
    if (variance < 0).any():
        axis = int(np.argmax(variance < 0))
        raise ValueError(f"the covariance has the variance {variance[axis]:.4g} at row {axis}")
    sigma = np.sqrt(variance)
    if (covariance[(sigma == 0), :] != 0).any() or (covariance[:, (sigma == 0)] != 0).any():
        raise ValueError("the covariance is not positive semi-definite: a row without variance has covariances")
    with np.errstate(over="ignore"):
        unit = np.where(sigma > 0, sigma, 1.0)
        correlation = covariance / unit[:, None] / unit
    off = np.abs(correlation - correlation.T).max()
    if not off <= COVARIANCE_TOLERANCE:
        raise ValueError(f"the covariance is not symmetric: correlations differ by {off:.4g}")
    least = float(np.linalg.eigvalsh((correlation + correlation.T) / 2).min())
    if not least >= -COVARIANCE_TOLERANCE:
        raise ValueError(f"the covariance is not positive semi-definite: its correlations have eigenvalue {least:.4g}")


def make_calibration(file: Path, camera: str, **values: Any) -> Calibration:
    """Make a calibration from the values of a recording's file.

    Args:
        file: the file that holds the values.
        camera: the camera's name.
        values: the other attributes of `Calibration`.

    Raises:
        RecordingError: a value is not valid for a camera; file, camera and attribute are named.
    """
    try:
        return Calibration(camera=camera, **values)
    except ValidationError as error:
        first = error.errors()[0]
        raise RecordingError(
            describe_problem_and_value(first),
            file=file,
            place=".".join((f"camera {camera}", *(str(part) for part in first["loc"]))),
            expected="the intrinsics and mounting of a camera",
            remedy="correct the file, or remove it: the camera is then uncalibrated",
        ) from error


def to_calibration(
    camera: str, lens: Camera, mounting: tuple[float, ...], method: str | None, **others: Any
) -> Calibration:
    """Return a calibration of a lens at a mounting.

    Args:
        camera: the camera's name.
        lens: the lens.
        mounting: ``ego_SE3_camera`` as ``qw qx qy qz tx_m ty_m tz_m``.
        method: how they were obtained.
        others: other attributes of `Calibration`.
    """
    return Calibration(
        camera=camera,
        model=lens.model,
        width_px=lens.width_px,
        height_px=lens.height_px,
        fx_px=lens.fx_px,
        fy_px=lens.fy_px,
        cx_px=lens.cx_px,
        cy_px=lens.cy_px,
        distortion=lens.distortion,
        ego_SE3_camera=mounting,
        method=method,
        **others,
    )


def to_calibration_table(
    calibrations: Sequence[tuple[Stage, Calibration]], *, vehicle_id: str, drive_id: str
) -> pa.Table:
    """Convert calibrations to rows of the `calibrations` table, in the same order.

    Args:
        calibrations: pairs of a stage and a calibration.
        vehicle_id: pseudonym of the vehicle.
        drive_id: the drive in which the calibrations are valid.
    """
    rows = []
    for stage, calibration in calibrations:
        row = calibration.model_dump(exclude={"ego_SE3_camera"})
        pose = calibration.ego_SE3_camera
        rotation = quaternion_normalise(np.array(pose[:4])).tolist()
        row |= {"vehicle_id": vehicle_id, "drive_id": drive_id, "stage": stage}
        row |= dict(zip(("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m"), (*rotation, *pose[4:])))
        rows.append(row)
    return pa.Table.from_pylist(rows, schema=CALIBRATIONS.schema)
