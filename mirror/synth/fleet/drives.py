"""The drives of a preset."""

from __future__ import annotations

from typing import Final

from mirror.errors import UsageError
from mirror.synth.fleet.drive import SynthDrive
from mirror.synth.fleet.presets import Preset, cycle_recipes, resolve_preset
from mirror.synth.fleet.recipe import Recipe
from mirror.synth.light.condition import Condition
from mirror.synth.light.sun import instant_of
from mirror.synth.rigs import VEHICLE_TYPES, Vehicle
from mirror.synth.seeds import derive_seed, is_secret_seed, random_stream, require_public_seed

_DAYS_LATER_NS: Final = 9 * 86_400_000_000_000
_OTHERS: Final = 1000
_TYPES: Final = tuple(VEHICLE_TYPES)


def make_drives(
    preset: str, seed: int, scenes: int | None = None, traversals: int | None = None
) -> tuple[Preset, list[SynthDrive]]:
    """Make all drives of a preset; a drive is simulated when its motion is first used.

    Args:
        preset: one of `mirror.synth.fleet.PRESETS`.
        seed: seed of all random choices, public or secret (`mirror.synth.seeds`).
        scenes: number of scenes; default: all scenes of the preset.
        traversals: number of drives with images through each scene; default: the preset's number.

    Returns:
        The preset and its drives.

    Raises:
        UsageError: the preset does not exist, it has fewer scenes, or the seed is out of range.
    """
    if not is_secret_seed(seed):
        require_public_seed(seed)
    definition, count, many = resolve_preset(preset, scenes, traversals)
    drives = []
    for scene in range(count):
        site = definition.sites[scene]
        drives += [
            _make_traversal_drive(definition, scene, place, recipe, seed)
            for place, recipe in enumerate(cycle_recipes(site, many))
        ]
        drives += [
            _make_other_drive(definition, scene, place, recipe, seed) for place, recipe in enumerate(site.others)
        ]
    return definition, drives


def make_drive(preset: str, seed: int, drive_id: str) -> SynthDrive:
    """Make one drive with images of a preset, whether or not the preset records it by default.

    Raises:
        UsageError: the preset or the drive does not exist, or the seed is out of range.
    """
    if not is_secret_seed(seed):
        require_public_seed(seed)
    definition, _, _ = resolve_preset(preset)
    scene_id, _, number = drive_id.rpartition("-")
    scenes = [scene for scene, site in enumerate(definition.sites) if site.roi.scene_id == scene_id]
    if not scenes or not number.isdecimal() or not 1 <= int(number) < _OTHERS:
        raise UsageError(f"no drive {drive_id!r} in preset {preset!r}", expected="<scene>-<number from 01>")
    place = int(number) - 1
    recipe = cycle_recipes(definition.sites[scenes[0]], place + 1)[-1]
    return _make_traversal_drive(definition, scenes[0], place, recipe, seed)


def _make_traversal_drive(preset: Preset, scene: int, place: int, recipe: Recipe, seed: int) -> SynthDrive:
    site = preset.sites[scene]
    later_ns = place // len(site.recipes) * _DAYS_LATER_NS
    return _make_drive(preset, scene, f"{site.roi.scene_id}-{place + 1:02d}", recipe, seed, place, later_ns)


def _make_other_drive(preset: Preset, scene: int, place: int, recipe: Recipe, seed: int) -> SynthDrive:
    return _make_drive(
        preset, scene, f"{preset.sites[scene].roi.scene_id}-{recipe.route}", recipe, seed, _OTHERS + place, 0
    )


def _make_drive(
    preset: Preset, scene: int, drive_id: str, recipe: Recipe, seed: int, position: int, later_ns: int
) -> SynthDrive:
    rng = random_stream("drive", seed, scene, position)
    roi = preset.sites[scene].roi
    number = len(_TYPES) * scene + _TYPES.index(recipe.vehicle)
    vehicle_seed = derive_seed("vehicle", seed, number, public=100 * seed + number)
    vehicle = Vehicle(f"vehicle-{number + 1}", VEHICLE_TYPES[recipe.vehicle], preset.width_px, vehicle_seed)
    start = later_ns + instant_of(
        recipe.date, recipe.light, roi.longitude_deg or 0.0, roi.latitude_deg or 0.0, morning=recipe.morning
    )
    start += int(rng.integers(20_000_000)) * 1000
    return SynthDrive(
        drive_id=drive_id,
        preset=preset,
        scene=scene,
        recipe=recipe,
        vehicle=vehicle,
        condition=Condition(start, recipe.light, recipe.weather, visit=position),
        world_seed=derive_seed("world", seed, scene, public=1000 * seed + scene),
        seed=derive_seed("traversal", seed, scene, position, public=int(rng.integers(1 << 30))),
    )
