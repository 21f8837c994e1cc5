"""The streets of the study: those that are driven in, by light, and those whose images train the perception."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Final, Literal

import numpy as np

from hybridworldsim.simulator.policies.protocol import CameraSpec
from hybridworldsim.simulator.renderers.protocol import rig_cameras
from hybridworldsim.simulator.street.ground import StreetGround
from hybridworldsim.simulator.street.of_synth import street_of_drive
from hybridworldsim.simulator.street.street import Street
from mirror.synth import street_map
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.fleet.drives import make_drive

Light = Literal["day", "night"]
LIGHTS: Final[tuple[Light, Light]] = ("day", "night")


@dataclass(frozen=True, eq=False)
class Place:
    """A street in the light, the weather and the camera of one drive.

    Attributes:
        street: the street, with the rig and the vehicle of the study.
        drive: the recorded drive.
        cameras: the camera of the policies, by its name.
    """

    street: Street
    drive: SynthDrive
    cameras: Mapping[str, CameraSpec]


@dataclass(frozen=True, eq=False)
class Vehicle:
    """The vehicle of the study: a street that has its rig, and the drive that it is taken from."""

    street: Street
    cameras: Mapping[str, CameraSpec]


@lru_cache(maxsize=1)
def open_vehicle(preset: str, seed: int, drive_id: str, camera: str, width_px: int, height_px: int) -> Vehicle:
    """Return the vehicle of a drive, with one of its cameras as a pinhole of a size."""
    street = street_of_drive(make_drive(preset, seed, drive_id))
    return Vehicle(street, rig_cameras(street, (camera,), width_px, height_px))


def vehicle_of(streets: Mapping[str, Any], camera: Mapping[str, Any]) -> Vehicle:
    """Return the vehicle that the declaration names: that of the first street's drive by day."""
    return open_vehicle(
        streets["preset"], streets["seeds"][0], f"{streets['site']}-{streets['day']}", camera["name"],
        camera["width_px"], camera["height_px"],
    )  # fmt: skip


@lru_cache(maxsize=4)
def _driven(preset: str, seed: int, drive_id: str) -> tuple[Street, SynthDrive]:
    drive = make_drive(preset, seed, drive_id)
    return street_of_drive(drive), drive


def open_place(vehicle: Vehicle, preset: str, seed: int, drive_id: str) -> Place:
    """Return a street that is driven in, with the recording of the drive."""
    street, drive = _driven(preset, seed, drive_id)
    return Place(replace(street, vehicle=vehicle.street.vehicle, rig=vehicle.street.rig), drive, vehicle.cameras)


def open_training_place(vehicle: Vehicle, preset: str, seed: int, drive_id: str) -> Place:
    """Return a street in the light of a drive whose traffic is not simulated."""
    drive = make_drive(preset, seed, drive_id)
    world = drive.world
    street = Street(
        drive.roi.scene_id, street_map(world.plan), StreetGround(world.height_m), vehicle.street.vehicle,
        vehicle.street.rig, {}, (0.0, 0.0), drive.roi.radius_m, roi=drive.roi, drive=drive,
    )  # fmt: skip
    return Place(street, drive, vehicle.cameras)


def time_inside_s(street: Street, after_m: float) -> float:
    """Return the time in the recording at which it has come so far into the part of the street that can be rendered."""
    recording = next(iter(street.recordings.values()))
    inside = street.is_inside(recording.poses[:, :2])
    first = int(np.argmax(inside))
    steps = np.hypot(*np.diff(recording.poses[first:, :2], axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    return float(np.interp(after_m, along, recording.times_s[first:]))
