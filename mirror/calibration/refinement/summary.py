"""What an adjustment says of each camera: its correction relative to the reference camera and to the vehicle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from mirror.arrays import Float64
from mirror.calibration.equations import exp_rotations
from mirror.calibration.estimate import AXES, OBSERVABLE_DEG
from mirror.calibration.refinement.adjustment import Adjustment, rotations
from mirror.calibration.refinement.scene import SceneRigs
from mirror.calibration.shutters import ShutterEstimate
from mirror.calibration.tracking import pixel_rad
from mirror.geometry import Poses, matrix_from_quaternion
from mirror.geometry.cameras import Camera

FEATURE_BIAS_PX: Final = 0.1
"""1-sigma of the error that all features of a camera share, about each axis; the scatter of the tracks hides it."""
_FEWEST: Final = 60


@dataclass(frozen=True, eq=False)
class CameraRefinement:
    """The refined calibration of one camera of one drive.

    Errors are those of the calibration that was refined. Relative ones do not depend on the recorded poses; those to
    the vehicle do.

    Attributes:
        camera: the camera.
        drive_id: its drive.
        reference: the camera that relative errors refer to.
        status: ``refined``, or ``kept``: the calibration stays as it was.
        reason: why it was kept; None: it was refined.
        relative_deg: angle of the error of the rotation relative to the reference camera.
        relative_sigma_deg: its standard deviation: the root of the trace of the covariance.
        vehicle_deg: (3,) error of the rotation to the vehicle: roll, pitch, yaw.
        vehicle_sigma_deg: (3,) standard deviations.
        held: axes about which the rotation of the rig to the vehicle is unobservable; there it is the median of the
            recorded rotations of the cameras.
        moved_cm: distance of the refined position from the earlier one.
        observations: number of observations.
        residual_px: median distance of the observations from the projections; None without any.
        ego_SE3_camera: the refined mounting.
        lens: the refined lens.
        covariance: (6, 6) of the mounting, in the camera frame: rotation (rad), then translation (m).
        shutter: readout and time offset that the images show; None: not estimated.
    """

    camera: str
    drive_id: str
    reference: str
    status: str
    reason: str | None
    relative_deg: float
    relative_sigma_deg: float
    vehicle_deg: Float64
    vehicle_sigma_deg: Float64
    held: tuple[str, ...]
    moved_cm: float
    observations: int
    residual_px: float | None
    ego_SE3_camera: Poses
    lens: Camera
    covariance: Float64
    shutter: ShutterEstimate | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the figures as plain values, for JSON."""
        return {
            "camera": self.camera,
            "drive_id": self.drive_id,
            "reference": self.reference,
            "status": self.status,
            "reason": self.reason,
            "relative_deg": self.relative_deg,
            "relative_sigma_deg": self.relative_sigma_deg,
            "vehicle_deg": dict(zip(AXES, self.vehicle_deg.tolist())),
            "vehicle_sigma_deg": dict(zip(AXES, self.vehicle_sigma_deg.tolist())),
            "held_axes": list(self.held),
            "moved_cm": self.moved_cm,
            "observations": self.observations,
            "residual_px": self.residual_px,
            "shutter": None if self.shutter is None else self.shutter.to_dict(),
        }


def summarise(adjusted: Adjustment, scene: SceneRigs, references: Sequence[str]) -> list[CameraRefinement]:
    """Return the refined calibration of each mounting.

    Where the images and recorded poses do not show the rotation of the whole rig to the vehicle (its standard deviation
    about an axis is above 0.1 degrees, such as roll on a straight road), the rig keeps the median of the recorded
    rotations of its cameras about that axis. A reference camera keeps its calibration where that is so about all
    axes and no other camera of its drive is refined: a median of recorded rotations is no estimate.

    Args:
        adjusted: the adjustment.
        scene: the scene that was adjusted.
        references: K reference cameras of the rigs of the mountings.
    """
    before = matrix_from_quaternion(scene.rigs.ego_SE3_camera.rotation)
    after = matrix_from_quaternion(adjusted.ego_SE3_camera.rotation)
    counts, mounting = adjusted.observations(), scene.rigs.mounting[adjusted.tracks.image]
    out = []
    for number, (used, drive_id) in enumerate(zip(scene.calibrations, scene.drives)):
        gauge = _reference_of(scene, number, references[number])
        members = [
            other
            for other, drive in enumerate(scene.drives)
            if drive == drive_id and (counts[other] >= _FEWEST or other == gauge)
        ]
        held, turn = _hold(adjusted, before, after, gauge, members)
        now = turn @ after[number]
        own = mounting == number
        covariance = _covariance(adjusted, number, number)
        covariance += _bias(adjusted.cameras[number])
        relative = after[gauge].T @ after[number]
        relative_covariance = _relative_covariance(adjusted, gauge, number, relative)
        if number != gauge:
            relative_covariance += _bias(adjusted.cameras[number])[:3, :3] + _bias(adjusted.cameras[gauge])[:3, :3]
        sigma = np.degrees(np.sqrt(np.diag(now @ covariance[:3, :3] @ now.T)))
        reason = None
        if counts[number] < _FEWEST:
            reason = f"{counts[number]} observations: too few features match"
        elif np.degrees(np.sqrt(np.diag(relative_covariance))).max() > OBSERVABLE_DEG:
            reason = "its rotation relative to the reference camera is unobservable: no overlap, or little motion"
        out.append(
            CameraRefinement(
                camera=used.camera,
                drive_id=drive_id,
                reference=scene.calibrations[gauge].camera,
                status="refined" if reason is None else "kept",
                reason=reason,
                relative_deg=float(np.degrees(np.linalg.norm(_log(before[gauge].T @ before[number] @ relative.T)))),
                relative_sigma_deg=float(np.degrees(np.sqrt(np.trace(relative_covariance)))),
                vehicle_deg=np.degrees(_log(before[number] @ now.T)),
                vehicle_sigma_deg=sigma,
                held=held,
                moved_cm=100.0
                * float(np.linalg.norm(adjusted.state.mount_places[number] - used.ego_SE3_camera.translation[0])),
                observations=int(counts[number]),
                residual_px=float(np.median(adjusted.residual_px[own])) if own.any() else None,
                ego_SE3_camera=Poses(rotations(now[None]).rotation, adjusted.state.mount_places[number : number + 1]),
                lens=adjusted.cameras[number],
                covariance=_in_camera_frame(covariance, now),
            )
        )
    return [_keep_unobservable(one, out) for one in out]


def _keep_unobservable(one: CameraRefinement, every: Sequence[CameraRefinement]) -> CameraRefinement:
    """The result of a camera, which is kept if it is a reference of which nothing could be observed."""
    others = any(other.status == "refined" and other.drive_id == one.drive_id and other is not one for other in every)
    if one.camera != one.reference or one.status != "refined" or others or len(one.held) < len(AXES):
        return one
    reason = "no axis of its rotation to the vehicle is observable, and no other camera is known relative to it"
    return replace(one, status="kept", reason=reason)


def _reference_of(scene: SceneRigs, mounting: int, camera: str) -> int:
    """The mounting that a drive's relative rotations refer to: its reference camera, or its first camera."""
    own = [number for number, drive in enumerate(scene.drives) if drive == scene.drives[mounting]]
    return next((number for number in own if scene.calibrations[number].camera == camera), own[0])


def _hold(
    adjusted: Adjustment, before: Float64, after: Float64, gauge: int, members: Sequence[int]
) -> tuple[tuple[str, ...], Float64]:
    """Axes about which the rig's rotation to the vehicle is unobservable, and the rotation (3, 3) of the whole rig.

    About these axes each recorded mounting says how the rig was turned, with an error of its own: the median of all
    cameras has a smaller error than one camera, and a single camera that was knocked does not turn the others.
    """
    block = after[gauge] @ _covariance(adjusted, gauge, gauge)[:3, :3] @ after[gauge].T
    unknown = np.degrees(np.sqrt(np.diag(block))) > OBSERVABLE_DEG
    back = np.median([_log(before[number] @ after[number].T) for number in members], axis=0)
    turn = exp_rotations(np.where(unknown, back, 0.0)[None])[0]
    return tuple(axis for axis, is_unknown in zip(AXES, unknown) if is_unknown), turn


def _covariance(adjusted: Adjustment, one: int, other: int) -> Float64:
    return adjusted.covariance[adjusted.mounting_columns(one), adjusted.mounting_columns(other)].copy()


def _relative_covariance(adjusted: Adjustment, gauge: int, number: int, relative: Float64) -> Float64:
    """Covariance (3, 3) of the rotation of a camera relative to the reference camera, about the latter's axes."""
    if gauge == number:
        return np.zeros((3, 3))
    cross = relative @ _covariance(adjusted, number, gauge)[:3, :3]
    own = relative @ _covariance(adjusted, number, number)[:3, :3] @ relative.T
    return own + _covariance(adjusted, gauge, gauge)[:3, :3] - cross - cross.T


def _bias(camera: Camera) -> Float64:
    """Covariance (6, 6) of what all features of a camera share."""
    out = np.zeros((6, 6))
    out[:3, :3] = (FEATURE_BIAS_PX * pixel_rad(camera)) ** 2 * np.eye(3)
    return out


def _in_camera_frame(covariance: Float64, turn: Float64) -> Float64:
    """The covariance with translations along the camera's axes instead of the vehicle's."""
    change = np.eye(6)
    change[3:, 3:] = turn.T
    out = change @ covariance @ change.T
    return 0.5 * (out + out.T)


def _log(matrix: Float64) -> Float64:
    return rotations(matrix[None]).log()[0, :3]
