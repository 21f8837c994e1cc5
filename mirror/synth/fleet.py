"""The drives of a preset as they truly were: vehicle, route, traffic and light, before anything is measured."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from mirror.arrays import Int64, UInt8
from mirror.geometry import Poses
from mirror.geometry.geodesy import TangentFrame
from mirror.synth.driving import Drive
from mirror.synth.lighting import Condition, instant_of
from mirror.synth.presets import TRAVERSALS, Preset, Recipe, ScenePlan, planned
from mirror.synth.rigs.former import SALOON, VAN, Vehicle
from mirror.synth.road_users import RoadUser
from mirror.synth.routes import drive_along
from mirror.synth.traffic import traffic
from mirror.synth.world import World, build_world

if TYPE_CHECKING:
    from mirror.synth.render.casting import Lens
    from mirror.synth.render.stage import Stage

_TYPES = (SALOON, VAN, SALOON)
_DAYS_LATER_NS = 9 * 86_400_000_000_000


@dataclass(frozen=True, eq=False)
class SynthDrive:
    """One drive, exactly known.

    Attributes:
        drive_id: its id.
        recipe: what was wished for.
        world: the static scene.
        vehicle: that was driven.
        condition: start, light and weather.
        truth: the vehicle's motion.
        users: everybody else.
        seed: of measurement noise and picture noise.
    """

    drive_id: str
    recipe: Recipe
    world: World
    vehicle: Vehicle
    condition: Condition
    truth: Drive
    users: tuple[RoadUser, ...]
    seed: int

    @cached_property
    def frame(self) -> TangentFrame:
        """The scene's east-north-up frame."""
        roi = self.world.roi
        return TangentFrame(roi.longitude_deg or 0.0, roi.latitude_deg or 0.0, roi.height_m)

    @cached_property
    def stage(self) -> Stage:
        """What renders it."""
        from mirror.synth.render.stage import Stage

        return Stage(self.world, self.condition, self.users, self.vehicle.kind.bonnet)

    @cached_property
    def lenses(self) -> dict[str, Lens]:
        """The vehicle's cameras as the renderer takes them."""
        from mirror.synth.render.casting import make_lens

        return {name: make_lens(camera) for name, camera in self.vehicle.cameras.items()}

    @cached_property
    def own_masks(self) -> dict[str, UInt8]:
        """Masks (H, W) of the vehicle itself, 255 where it is seen, of the cameras that see it."""
        from mirror.synth.render.stage import own_mask

        masks = {
            name: own_mask(lens, self.vehicle.ego_SE3_camera[name], self.vehicle.kind.bonnet)
            for name, lens in self.lenses.items()
        }
        return {name: mask for name, mask in masks.items() if mask.any()}

    def world_SE3_ego(self, timestamp_ns: Int64) -> Poses:  # noqa: N802
        """True poses at Unix times (N,), in the scene's frame."""
        return self.truth.poses((timestamp_ns - self.condition.start_ns).astype(np.float64) * 1e-9)


def drives_of(
    preset: str, seed: int, scenes: int | None = None, traversals: int | None = None
) -> tuple[Preset, list[SynthDrive]]:
    """All drives of a preset.

    Args:
        preset: one of `mirror.synth.presets.PRESETS`.
        seed: of everything that is left to chance.
        scenes: how many scenes; default: all that the preset has.
        traversals: how many drives with pictures through each; default: the preset's.

    Raises:
        UsageError: there is no such preset, or it has no so many scenes.
    """
    settings, plans = planned(preset, scenes, traversals)
    drives = []
    for number, (scene, recipes) in enumerate(plans):
        world = build_world(scene.roi, scene.yaw_deg, 1000 * seed + number)
        for position, recipe in enumerate(recipes):
            drives.append(_drive(settings, scene, world, recipe, number, position, seed))
    return settings, drives


def _drive(
    settings: Preset, scene: ScenePlan, world: World, recipe: Recipe, scene_number: int, position: int, seed: int
) -> SynthDrive:
    rng = np.random.default_rng([seed, scene_number, position])
    roi = scene.roi
    number = 3 * scene_number + recipe.vehicle
    vehicle = Vehicle(
        f"vehicle-{number + 1}", _TYPES[recipe.vehicle], settings.width_px, settings.height_px, 100 * seed + number
    )
    start = instant_of(
        recipe.date, recipe.light, roi.longitude_deg or 0.0, roi.latitude_deg or 0.0, morning=recipe.morning
    )
    # Recipes come round again after the last: then some days later.
    start += position // len(TRAVERSALS) * _DAYS_LATER_NS if recipe in TRAVERSALS else 0
    truth = drive_along(
        world,
        recipe.route,
        scene.speed_mps * rng.uniform(0.92, 1.05),
        aside_m=rng.uniform(-0.25, 0.25),
        sway=rng.uniform(0, 6),
    )
    return SynthDrive(
        drive_id=f"{roi.scene_id}-{position + 1:02d}",
        recipe=recipe,
        world=world,
        vehicle=vehicle,
        condition=Condition(start + int(rng.integers(20_000_000_000)), recipe.light, recipe.weather),
        truth=truth,
        users=traffic(world, truth, recipe.route, rng),
        seed=int(rng.integers(1 << 30)),
    )
