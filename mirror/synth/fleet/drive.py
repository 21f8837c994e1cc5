"""The ground truth of one drive: vehicle, motion, traffic and light. Renders any image of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from mirror.arrays import Float64, Int64, Records, UInt8
from mirror.geometry import Poses
from mirror.geometry.geodesy import TangentFrame
from mirror.schema.documents import CANONICAL_CAMERAS, Roi
from mirror.synth.fleet.presets import PRESETS, Preset, Site
from mirror.synth.fleet.recipe import Recipe
from mirror.synth.light.condition import Condition
from mirror.synth.light.sun import season_of
from mirror.synth.model import Model
from mirror.synth.rigs import Vehicle, VehicleType
from mirror.synth.rigs.ego_model import make_ego_model
from mirror.synth.seeds import random_stream, seed_sequence

if TYPE_CHECKING:
    from mirror.synth.driving.drive import Drive
    from mirror.synth.driving.journey import Journey
    from mirror.synth.render.develop import CameraResponse
    from mirror.synth.render.lens import Lens
    from mirror.synth.render.scene import Instant, RenderedImage, RollingImage, Scene
    from mirror.synth.road_users.body import RoadUser
    from mirror.synth.street.world import World

_WORLDS_HELD: Final = 2
_VEHICLES_HELD: Final = 7
_BUSTLE: Final = {"day": (1.0, 1.0), "dusk": (0.9, 0.7), "night": (0.45, 0.3)}
_WARM_MONTHS: Final = (0.36, 0.75)
_STEP_S: Final = 0.01


@dataclass(frozen=True, eq=False)
class SynthDrive:
    """The ground truth of one drive. Expensive parts are computed at their first use.

    Attributes:
        drive_id: id of the drive.
        preset: preset of the drive.
        scene: index of the scene in the preset.
        recipe: specification of the drive.
        vehicle: recording vehicle.
        condition: start time, light and weather.
        world_seed: seed of the scene.
        seed: seed of the traffic, of measurement noise and of image noise.
    """

    drive_id: str
    preset: Preset
    scene: int
    recipe: Recipe
    vehicle: Vehicle
    condition: Condition
    world_seed: int = field(repr=False)
    seed: int = field(repr=False)

    @property
    def site(self) -> Site:
        """The scene of the drive."""
        return self.preset.sites[self.scene]

    @property
    def roi(self) -> Roi:
        """The region of interest of the scene."""
        return self.site.roi

    @cached_property
    def frame(self) -> TangentFrame:
        """The scene's east-north-up frame."""
        roi = self.roi
        return TangentFrame(roi.longitude_deg or 0.0, roi.latitude_deg or 0.0, roi.height_m)

    @property
    def rig_id(self) -> str:
        """Id of the rig; each vehicle has its own rig, as mountings and ego masks differ between vehicles."""
        return f"{self.vehicle.kind.name}-{self.vehicle.vehicle_id.rpartition('-')[2]}"

    @property
    def world(self) -> World:
        """The static world of the scene; drives share a small cache of worlds."""
        return _cached_world(self.preset.name, self.scene, self.world_seed)

    @cached_property
    def _journey(self) -> Journey:
        from mirror.synth.driving.journey import simulate_journey
        from mirror.synth.driving.site import TrafficDensity, TrafficSite
        from mirror.traffic.placement.trace import Chassis

        world, size, condition = self.world, self.vehicle.kind.size, self.condition
        rng = random_stream("journey", self.seed, 0)
        vehicles, people = (self.site.bustle * share for share in _BUSTLE[condition.light])
        wet = condition.weather == "rain"
        season = season_of(condition.start_ns, self.roi.latitude_deg or 0.0)
        bustle = TrafficDensity(
            vehicles, people * (0.6 if wet else 1.0), wet, _WARM_MONTHS[0] < season < _WARM_MONTHS[1]
        )
        chassis = Chassis(size.length_m, size.width_m, size.wheelbase_m, size.rear_m, 0.0)
        return simulate_journey(
            TrafficSite(world.network, world.roi.radius_m, world.height_m),
            self.recipe.route,
            chassis,
            self.seed,
            scene_seed=self.world_seed,
            variant=self.recipe.variant,
            fastest_mps=self.site.fastest_mps * rng.uniform(0.92, 1.05),
            aside_m=rng.uniform(-0.25, 0.25),
            bustle=bustle,
        )

    @property
    def truth(self) -> Drive:
        """The motion of the recording vehicle."""
        return self._journey.drive

    @property
    def road_users(self) -> tuple[RoadUser, ...]:
        """All other road users, including the parked vehicles."""
        return self._journey.road_users

    @property
    def ego_model(self) -> Model:
        """The parts of the vehicle that its own cameras see, in its ego frame."""
        return _own_model(self.vehicle.kind)

    @property
    def ego_masks(self) -> dict[str, UInt8]:
        """Masks (H, W) of the recording vehicle, by camera name: 255 where it is visible. Empty masks are left out."""
        return _own_masks(self.vehicle)

    @property
    def lenses(self) -> dict[str, Lens]:
        """The rays of each camera, by camera name."""
        return _lenses(self.vehicle)

    @cached_property
    def camera_responses(self) -> dict[str, CameraResponse]:
        """The response of each camera to light, by camera name."""
        from mirror.synth.render.develop import draw_camera_response

        return {
            name: draw_camera_response(seed_sequence("responses", self.vehicle.seed, place))
            for place, name in enumerate(CANONICAL_CAMERAS)
        }

    @cached_property
    def drops(self) -> dict[str, Records]:
        """Rain drops on the lenses, by camera name; empty without rain."""
        from mirror.synth.render.develop import draw_lens_drops

        if self.condition.weather != "rain":
            return {}
        return {
            name: draw_lens_drops(seed_sequence("drops", self.seed, place), camera.height_px / camera.width_px)
            for place, (name, camera) in enumerate(self.vehicle.cameras.items())
        }

    @cached_property
    def stage(self) -> Scene:
        """The scene in the drive's condition, which renders instants and images."""
        from mirror.synth.render.scene import Scene

        return Scene(self.world, self.condition, self.road_users, self.ego_model, clock_s=self.truth.clock_s)

    def prepare(self) -> None:
        """Compute the data that threads share, once, before the threads start."""
        self.stage.prepare()
        _ = self.lenses, self.camera_responses, self.drops

    def forget(self) -> None:
        """Release the large cached parts, which are computed again at their next use."""
        for name in ("stage", "_journey"):
            vars(self).pop(name, None)

    def seconds(self, timestamp_ns: Int64) -> Float64:
        """Return the seconds (N,) between the start of the drive and Unix times (N,)."""
        return (np.asarray(timestamp_ns, np.int64) - self.condition.start_ns).astype(np.float64) * 1e-9

    def world_SE3_ego(self, timestamp_ns: Int64) -> Poses:  # noqa: N802
        """Return the true poses of the vehicle at Unix times (N,), in the scene's frame."""
        return self.truth.poses(self.seconds(timestamp_ns))

    def world_SE3_camera(self, camera: str, timestamp_ns: Int64) -> Poses:  # noqa: N802
        """Return the true poses of a camera at Unix times (N,), in the scene's frame."""
        return self.world_SE3_ego(timestamp_ns) @ self.vehicle.ego_SE3_camera[camera]

    def placements(self, user: RoadUser, timestamp_ns: Int64) -> tuple[Float64, Float64]:
        """Return a road user's placements (N, 6) x, y, z, yaw, pitch, roll and speeds (N,) at Unix times (N,)."""
        from mirror.traffic.placement.trace import TraceMotion

        motion = user.motion
        if isinstance(motion, TraceMotion):
            along, speed = motion.schedule.at(self.seconds(timestamp_ns))
            pose, forward = motion.trace.at(along)
            return pose, forward * speed
        at = motion.at(0.0)
        row = (at.x_m, at.y_m, at.z_m, at.yaw_rad, at.pitch_rad, at.roll_rad)
        return np.tile(row, (len(timestamp_ns), 1)), np.full(len(timestamp_ns), at.speed_mps)

    def at(self, timestamp_ns: int) -> Instant:
        """Return the world at a Unix time."""
        stamps = np.array([timestamp_ns])
        return self.stage.at(float(self.seconds(stamps)[0]), self.world_SE3_ego(stamps))

    def render(
        self, camera: str, timestamp_ns: int, instant: Instant | None = None, *, noise_seed: int | None = None
    ) -> RenderedImage | RollingImage:
        """Render the image of a camera, through its shutter.

        Args:
            camera: name of the camera.
            timestamp_ns: true mid-exposure time.
            instant: the world at that time, from `at`; default: it is computed.
            noise_seed: seed of other noise than the recorded image has; None: the recorded noise.
        """
        from mirror.synth.render.scene import Twist

        place = CANONICAL_CAMERAS.index(camera)
        stamps = timestamp_ns + np.array([-1, 0, 1]) * round(_STEP_S * 1e9)
        poses = self.world_SE3_camera(camera, stamps)
        turn, velocity = ((poses[:1].inverse() @ poses[2:]).log()[0] / (2.0 * _STEP_S)).reshape(2, 3)
        twist = Twist(tuple(velocity.tolist()), tuple(turn.tolist()), self.vehicle.kind.exposure_ns * 1e-9)
        noise = seed_sequence("noise", self.seed, place, timestamp_ns).generate_state(1, np.uint64)[0]
        instant = self.at(timestamp_ns) if instant is None else instant
        lens, shutter = self.lenses[camera], self.vehicle.shutter(camera)
        development: dict[str, Any] = {
            "response": self.camera_responses[camera],
            "seed": int(noise >> np.uint64(1)) if noise_seed is None else noise_seed,
            "drops": self.drops.get(camera),
            "twist": twist,
        }
        if not shutter.is_rolling:
            return self.stage.render(instant, lens, poses[1:2], **development)
        offsets_ns = shutter.line_offsets_ns()
        egos = self._egos_about(timestamp_ns, offsets_ns)
        return self.stage.render_lines(
            instant,
            lens,
            float(self.seconds(np.array([timestamp_ns]))[0]) + 1e-9 * offsets_ns,
            egos,
            egos @ self.vehicle.ego_SE3_camera[camera],
            columns=shutter.reads_columns,
            **development,
        )

    def poses_about(self, camera: str, timestamp_ns: int, offsets_ns: Float64) -> Poses:
        """Return the true poses of a camera at offsets (N,) from a Unix time, in the scene's frame."""
        return self._egos_about(timestamp_ns, offsets_ns) @ self.vehicle.ego_SE3_camera[camera]

    def _egos_about(self, timestamp_ns: int, offsets_ns: Float64) -> Poses:
        return self.truth.poses(float(self.seconds(np.array([timestamp_ns]))[0]) + 1e-9 * offsets_ns)


@lru_cache(_WORLDS_HELD)
def _cached_world(preset: str, scene: int, seed: int) -> World:
    from mirror.synth.street.world import build_world

    site = PRESETS[preset].sites[scene]
    return build_world(site.roi, site.yaw_deg, seed)


@lru_cache(_VEHICLES_HELD)
def _own_model(kind: VehicleType) -> Model:
    return make_ego_model(kind)


@lru_cache(_VEHICLES_HELD)
def _own_masks(vehicle: Vehicle) -> dict[str, UInt8]:
    from mirror.synth.truth.casting import ego_mask

    ego_model, mountings = _own_model(vehicle.kind), vehicle.ego_SE3_camera
    masks = {name: ego_mask(ego_model, camera, mountings[name]) for name, camera in vehicle.cameras.items()}
    return {name: mask for name, mask in masks.items() if mask.any()}


@lru_cache(_VEHICLES_HELD)
def _lenses(vehicle: Vehicle) -> dict[str, Lens]:
    from mirror.synth.render.lens import make_lens

    return {name: make_lens(camera) for name, camera in vehicle.cameras.items()}
