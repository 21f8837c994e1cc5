"""One recording vehicle: its true cameras differ from the design by manufacturing tolerances."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Final

from mirror.geometry import Poses
from mirror.geometry.cameras import Camera
from mirror.geometry.rolling_shutter import RollingShutter, ShutterDirection
from mirror.synth.errors import CameraClock, Errors, MountingError, Stage, perturb_intrinsics
from mirror.synth.rigs.types import VehicleType
from mirror.synth.seeds import random_stream

_INSTALLED: Final = MountingError(0.4, 0.01)
_FOCAL_TOLERANCE: Final = 0.004
_CENTRE_TOLERANCE: Final = 0.004
_STAGES: Final[tuple[Stage, ...]] = ("factory", "online")


@dataclass(frozen=True)
class CameraReadout:
    """The rolling shutter of one camera.

    Attributes:
        camera: name of the camera.
        direction: direction in which lines are exposed.
        readout_ns: from the start of the first line's exposure to the start of the last line's.
    """

    camera: str
    direction: ShutterDirection
    readout_ns: int


@dataclass(frozen=True)
class Vehicle:
    """A recording vehicle of the synthetic street.

    Attributes:
        vehicle_id: pseudonym of the vehicle.
        kind: type of the vehicle.
        width_px: image width of the preset; it sets the raster of each camera.
        seed: seed of the tolerances and of the factory calibration.
        readouts: shutters of cameras that differ from the type's.
    """

    vehicle_id: str
    kind: VehicleType
    width_px: int
    seed: int = field(repr=False)
    readouts: tuple[CameraReadout, ...] = ()

    def shutter(self, camera: str) -> RollingShutter:
        """Return the shutter of a camera: that of its readout, else that of the vehicle type."""
        chosen = {readout.camera: readout for readout in self.readouts}.get(camera)
        direction, readout_ns = (
            (self.kind.shutter, self.kind.readout_ns) if chosen is None else (chosen.direction, chosen.readout_ns)
        )
        raster = self.cameras[camera]
        return RollingShutter(direction, readout_ns, raster.width_px, raster.height_px)

    @cached_property
    def cameras(self) -> dict[str, Camera]:
        """True intrinsics by camera name, in canonical order."""
        rng = random_stream("lenses", self.seed, 1)
        return {
            mount.camera: perturb_intrinsics(
                mount.optics.camera(mount.raster, self.width_px), _FOCAL_TOLERANCE, _CENTRE_TOLERANCE, rng
            )
            for mount in self.kind.mounts
        }

    @cached_property
    def ego_SE3_camera(self) -> dict[str, Poses]:  # noqa: N802
        """True mountings by camera name."""
        rng = random_stream("mountings", self.seed, 2)
        return {mount.camera: mount.ego_SE3_camera() @ _INSTALLED.draw(rng) for mount in self.kind.mounts}

    def calibration(
        self, stage: Stage, errors: Errors, drive: int, clocks: Mapping[str, CameraClock]
    ) -> list[dict[str, Any]]:
        """Return the calibration of every camera at a stage: the entries of ``calibrations/<stage>.json``.

        Args:
            stage: factory or online.
            errors: errors of the calibration.
            drive: seed of the drive; the online calibration differs between drives.
            clocks: clock of each camera.
        """
        number = _STAGES.index(stage)
        mountings = random_stream("mounting errors", self.seed, 3, number, drive if stage == "online" else 0)
        lenses = random_stream("lens errors", self.seed, 4)
        error = errors.mounting_error(stage)
        return [
            self._entry(
                name,
                errors.perturb_camera(self.cameras[name], lenses),
                self.ego_SE3_camera[name] @ error.draw(mountings),
                time_offset_ns=clocks[name].offset_ns,
                covariance=error.covariance(),
                method=f"synthetic, {stage} error",
            )
            for name in self.cameras
        ]

    def true_calibration(self) -> list[dict[str, Any]]:
        """Return the true calibration, in the same form as `calibration`."""
        return [
            self._entry(
                name, camera, self.ego_SE3_camera[name], time_offset_ns=0, covariance=None, method="synthetic, truth"
            )
            for name, camera in self.cameras.items()
        ]

    def _entry(
        self,
        name: str,
        camera: Camera,
        ego_SE3_camera: Poses,
        *,
        time_offset_ns: int,
        covariance: list[float] | None,
        method: str,
    ) -> dict[str, Any]:
        return {
            "camera": name,
            **camera.to_row(),
            "ego_SE3_camera": [*ego_SE3_camera.rotation[0].tolist(), *ego_SE3_camera.translation[0].tolist()],
            "valid_from_ns": None,
            "valid_to_ns": None,
            "time_offset_ns": time_offset_ns,
            "shutter_direction": self.shutter(name).direction,
            "readout_ns": self.shutter(name).readout_ns,
            "covariance": covariance,
            "method": method,
        }
