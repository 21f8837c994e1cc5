"""The street of a synthetic drive: everything about it is exact."""

from __future__ import annotations

import numpy as np

from hybridworldsim.simulator.agents.replay import RecordedTrack
from hybridworldsim.simulator.agents.states import Agent
from hybridworldsim.simulator.ego.vehicle import VehicleParameters
from hybridworldsim.simulator.street.ground import StreetGround
from hybridworldsim.simulator.street.street import EgoCamera, Street, StreetRecording
from mirror.errors import UsageError
from mirror.synth import SynthDrive

SCHEME = "synth:"
_STEP_S = 0.1


def open_synthetic_street(name: str) -> Street:
    """Open a synthetic street by its name ``synth:PRESET[:SEED[:DRIVE]]``; by default seed 0 and the first drive.

    Raises:
        UsageError: the name is malformed, or there is no such preset or drive.
    """
    from mirror.synth import make_drive, make_drives, parse_public_seed

    preset, *rest = name.removeprefix(SCHEME).split(":")
    if not name.startswith(SCHEME) or len(rest) > 2:
        raise UsageError(f"{name!r}", expected=f"{SCHEME}PRESET, {SCHEME}PRESET:SEED or {SCHEME}PRESET:SEED:DRIVE")
    seed = parse_public_seed(rest[0], f"the seed of {SCHEME}PRESET:SEED") if rest else 0
    drive = make_drive(preset, seed, rest[1]) if len(rest) == 2 else make_drives(preset, seed, traversals=1)[1][0]
    return street_of_drive(drive)


def street_of_drive(drive: SynthDrive) -> Street:
    """Return the street of a drive."""
    from mirror.synth import street_map

    size, truth = drive.vehicle.kind.size, drive.truth
    vehicle = VehicleParameters(
        length_m=size.length_m,
        width_m=size.width_m,
        height_m=size.height_m,
        wheelbase_m=size.wheelbase_m,
        rear_axle_to_center_m=size.middle_m,
    )
    times = np.arange(0.0, truth.duration_s, _STEP_S)
    along, _ = truth.schedule.at(times)
    places, _ = truth.trace.at(along)
    stamps = drive.condition.start_ns + np.round(times * 1e9).astype(np.int64)
    recording = StreetRecording(
        drive.drive_id,
        drive.condition.start_ns,
        times,
        places[:, (0, 1, 3)],
        tuple(_tracks(drive, times, stamps)),
        drive.condition.light,
        drive.condition.weather,
    )
    rig = {
        name: EgoCamera(camera, drive.vehicle.ego_SE3_camera[name], drive.vehicle.shutter(name))
        for name, camera in drive.vehicle.cameras.items()
    }
    return Street(
        scene_id=drive.roi.scene_id,
        road_map=street_map(drive.world.plan),
        map_source="synthetic",
        ground=StreetGround(drive.world.height_m),
        vehicle=vehicle,
        rig=rig,
        recordings={drive.drive_id: recording},
        middle_m=(0.0, 0.0),
        radius_m=drive.roi.radius_m,
        clock_s=truth.clock_s,
        roi=drive.roi,
        drive=drive,
    )


def _tracks(drive: SynthDrive, times: np.ndarray, stamps: np.ndarray) -> list[RecordedTrack]:
    from mirror.traffic.placement.motion import StaticMotion

    tracks = []
    for user in drive.road_users:
        agent = Agent(user.track_id, user.body.category, user.body.size_m, user.body)
        if isinstance(user.motion, StaticMotion):
            place = user.motion.placement
            tracks.append(RecordedTrack(agent, np.zeros(1), np.array([[place.x_m, place.y_m, place.yaw_rad]])))
            continue
        poses, _ = drive.placements(user, stamps)
        schedule = user.motion.schedule  # type: ignore[attr-defined]
        there = (times >= schedule.begin_s) & (times <= schedule.end_s)
        if there.sum() >= 2:
            tracks.append(RecordedTrack(agent, times[there], poses[there][:, (0, 1, 3)]))
    return tracks
