"""Presets: the scenes, and the drives through them by light, weather, route and vehicle."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import cycle, islice
from typing import Final

from mirror.errors import UsageError
from mirror.schema.documents import Roi
from mirror.synth.errors import Errors
from mirror.synth.fleet import places
from mirror.synth.fleet.recipe import Recipe, make_recipes


@dataclass(frozen=True)
class Site:
    """One scene and the drives through it.

    Attributes:
        roi: region of interest of the scene.
        yaw_deg: direction of the main street, counter-clockwise from east.
        fastest_mps: speed limit of the recording vehicles.
        recipes: drives with images, in this order; after the last one they repeat from the first.
        others: further drives, each on another route, which exercise the branches of the trigger.
        bustle: density of the traffic, as a share of that of a busy day.
    """

    roi: Roi
    yaw_deg: float
    fastest_mps: float
    recipes: tuple[Recipe, ...]
    others: tuple[Recipe, ...] = ()
    bustle: float = 1.0


@dataclass(frozen=True)
class Preset:
    """A named set of synthetic recordings.

    Attributes:
        name: name of the preset.
        sites: the scenes.
        traversals: number of drives with images through each scene.
        width_px: image width of a sensor with share 1; see `mirror.synth.rigs.mount.SensorRaster`.
        image_hz: images per second of each camera.
        pose_hz: poses per second.
        on_demand: True: recordings refer to images by URI, and images are rendered when they are loaded.
        errors: measurement errors of the recordings.
    """

    name: str
    sites: tuple[Site, ...]
    traversals: int
    width_px: int
    image_hz: float
    pose_hz: float = 20.0
    on_demand: bool = False
    errors: Errors = field(default_factory=Errors)


_SHOWN: Final = (
    Recipe("along", "day", "clear", "2025-05-14", "saloon"),
    Recipe("back", "night", "clear", "2025-11-19", "suv", poses="parquet", lost=("rear", 5)),
    Recipe("along", "day", "rain", "2025-06-11", "hatchback", poses="parts"),
    Recipe("back", "dusk", "clear", "2025-07-02", "saloon"),
    Recipe("turn", "day", "clouds", "2025-10-22", "suv", poses="gps", morning=True),
    Recipe("along", "night", "rain", "2025-12-03", "suv"),
    Recipe("twice", "day", "clear", "2025-08-20", "estate", morning=True),
)
"""Traversals of the small presets: the first few contain each route, light, weather and pose layout."""

_SKIMS: Final = Recipe("corner", "day", "clear", "2025-05-15", "saloon")
_SKIMS_UNSEEN: Final = Recipe("corner", "day", "clear", "2025-05-15", "saloon", images=False)
_PASSES_FAST: Final = Recipe("edge", "dusk", "clear", "2025-05-16", "van", poses="heading", images=False)
_STANDS: Final = Recipe("still", "day", "clear", "2025-05-17", "hatchback", poses="parquet", images=False)
_TURNS_ROUND: Final = Recipe("uturn", "night", "clear", "2025-05-18", "suv", images=False)
_POSES_ONLY: Final = Recipe("back", "day", "clouds", "2025-09-09", "bus", poses="heading", images=False)

_URBAN: Final = (("along", 0), ("back", 0), ("turn", 0), ("across", 0), ("left", 0))
_CAMPUS: Final = (("along", 0), ("back", 0), ("left", 0), ("turn", 0), ("across", 0))
_RURAL: Final = (("along", 0), ("back", 0), ("turn", 0), ("along", 0), ("back", 0))
_HIGHWAY: Final = (("along", 0), ("back", 0), ("change", 0), ("other", 0), ("back", 1), ("leave", 0), ("other", 1))
_SEVEN: Final = ("saloon", "truck", "suv", "hatchback", "bus", "estate", "van")


def _rotate(recipes: tuple[Recipe, ...], by: int) -> tuple[Recipe, ...]:
    """Rotate the order of recipes, so that scenes begin with different ones."""
    return (*recipes[by:], *recipes[:by])


def _benchmark() -> Preset:
    def site(number: int, roi: Roi, yaw_deg: float, fastest_mps: float, routes: tuple[tuple[str, int], ...]) -> Site:
        return Site(roi, yaw_deg, fastest_mps, make_recipes(routes, _SEVEN, 8, 5 * number))

    return Preset(
        "benchmark",
        (
            site(0, places.GUANGZHOU_URBAN, 24.0, 12.0, _URBAN),
            site(1, places.LYON_HIGHWAY, 71.0, 25.0, _HIGHWAY),
            site(2, places.KARLSRUHE_RURAL, -38.0, 16.0, _RURAL),
            site(3, places.KARLSRUHE_CAMPUS, -61.0, 9.0, _CAMPUS),
        ),
        traversals=8,
        width_px=960,
        image_hz=2.0,
    )


def _block(roi: Roi, yaw_deg: float, radius_m: float, first: int) -> Site:
    """A scene of one block, driven in both directions in five conditions."""
    routes = (("along", 0), ("back", 0))
    return Site(places.with_radius(roi, radius_m), yaw_deg, 7.5, make_recipes(routes, _SEVEN, 5, first), bustle=0.6)


def _calibration() -> Preset:
    """A bend by day with images at most 3.5 m apart: roll, pitch and yaw of each camera are observable in it."""
    recipes = (Recipe("turn", "day", "clear", "2025-08-20", "saloon"),)
    site = Site(places.with_radius(places.GUANGZHOU_URBAN, 50.0), 24.0, 7.5, recipes, bustle=0.4)
    return Preset("calibration", (site,), traversals=1, width_px=480, image_hz=2.0)


def _reconstruction() -> Preset:
    sites = (
        _block(places.GUANGZHOU_URBAN, 24.0, 50.0, 0),
        _block(places.KARLSRUHE_RURAL, -38.0, 50.0, 1),
        _block(places.KARLSRUHE_CAMPUS, -61.0, 50.0, 2),
    )
    return Preset("reconstruction", sites, traversals=5, width_px=480, image_hz=1.0)


def _ten_scenes() -> tuple[Site, ...]:
    scenes = (
        (places.GUANGZHOU_URBAN, 24.0, 13.0, _URBAN),
        (places.KARLSRUHE_CAMPUS, -61.0, 10.0, _CAMPUS),
        (places.LYON_HIGHWAY, 71.0, 22.0, _HIGHWAY),
        (places.KARLSRUHE_RURAL, -38.0, 12.0, _RURAL),
        (places.LYON_URBAN, 102.0, 13.0, _URBAN),
        (places.TORONTO_URBAN, -16.0, 13.0, _URBAN),
        (places.TORONTO_RURAL, 55.0, 12.0, _RURAL),
        (places.SANTIAGO_URBAN, 8.0, 13.0, _URBAN),
        (places.WUHAN_CAMPUS, 140.0, 10.0, _CAMPUS),
        (places.GUANGZHOU_HIGHWAY, -22.0, 22.0, _HIGHWAY),
    )
    return tuple(
        Site(roi, yaw_deg, fastest_mps, make_recipes(routes, _SEVEN, 14, 3 * number))
        for number, (roi, yaw_deg, fastest_mps, routes) in enumerate(scenes)
    )


_TINY: Final = places.with_radius(places.GUANGZHOU_URBAN, 62.0)

PRESETS: Final = {
    preset.name: preset
    for preset in (
        Preset("tiny", (Site(_TINY, 24.0, 9.0, _SHOWN, (_SKIMS_UNSEEN,), bustle=0.5),), 2, 160, image_hz=0.5),
        Preset(
            "quick",
            (Site(_TINY, 24.0, 9.0, _SHOWN, (_SKIMS_UNSEEN, _PASSES_FAST, _STANDS, _POSES_ONLY), bustle=0.5),),
            traversals=5,
            width_px=320,
            image_hz=0.3,
        ),
        Preset(
            "demo",
            (
                Site(places.GUANGZHOU_URBAN, 24.0, 14.0, _SHOWN, (_SKIMS, _PASSES_FAST, _STANDS, _TURNS_ROUND), 0.8),
                Site(
                    places.with_radius(places.KARLSRUHE_CAMPUS, 120.0), -61.0, 10.0, _rotate(_SHOWN, 3), (_POSES_ONLY,)
                ),
            ),
            traversals=5,
            width_px=400,
            image_hz=0.3,
        ),
        Preset("block", (_block(places.KARLSRUHE_CAMPUS, -61.0, 50.0, 2),), 5, 240, image_hz=0.5),
        Preset("block-960", (_block(places.KARLSRUHE_CAMPUS, -61.0, 50.0, 2),), 5, 960, image_hz=0.5),
        _calibration(),
        _reconstruction(),
        _benchmark(),
        Preset("annotation", _ten_scenes(), traversals=3, width_px=192, image_hz=0.25),
        Preset("paper", _ten_scenes(), traversals=14, width_px=960, image_hz=10.0, pose_hz=100.0, on_demand=True),
    )
}
"""All presets, by name. ``tiny`` is for tests, ``quick`` and ``demo`` are for demonstrations, ``block`` and
``reconstruction`` have one and three blocks of a street, ``block-960`` is ``block`` in images for a GPU,
``benchmark`` has four kinds of scene in six conditions, ``calibration`` has one drive at the rate that calibration
needs, ``annotation`` has small images of ten scenes in six cities, to train detectors, and ``paper`` is as large as
the paper's dataset: ten scenes in six cities, seven vehicle types, images on demand."""


def resolve_preset(preset: str, scenes: int | None = None, traversals: int | None = None) -> tuple[Preset, int, int]:
    """Return a preset and the numbers of scenes and traversals, with defaults applied.

    Args:
        preset: one of `PRESETS`.
        scenes: number of scenes; default: all scenes of the preset.
        traversals: number of drives with images through each scene; default: the preset's number.

    Raises:
        UsageError: the preset does not exist, it has fewer scenes, or ``traversals`` is below 1.
    """
    if preset not in PRESETS:
        raise UsageError(f"no preset {preset!r}", expected=f"one of {', '.join(PRESETS)}")
    definition = PRESETS[preset]
    count = len(definition.sites) if scenes is None else scenes
    if not 1 <= count <= len(definition.sites):
        raise UsageError(
            f"{count} scenes of preset {preset!r}", place="--scenes", expected=f"1 to {len(definition.sites)}"
        )
    traversal_count = definition.traversals if traversals is None else traversals
    if traversal_count < 1:
        raise UsageError(f"{traversal_count} traversals a scene", place="--traversals", expected="at least 1")
    return definition, count, traversal_count


def cycle_recipes(site: Site, traversals: int) -> list[Recipe]:
    """Return the recipes of the first ``traversals`` drives with images; after the last recipe they repeat."""
    return list(islice(cycle(site.recipes), traversals))
