"""What is recorded: scenes, and the drives through them by light, weather, route and vehicle."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import cycle, islice
from typing import Final, Literal

from mirror.errors import UsageError
from mirror.recordings.light import Light
from mirror.schema.documents import Roi
from mirror.synth.lighting import Weather

PoseStyle = Literal["csv", "parquet", "parts", "heading", "gps"]
"""How poses are written: one CSV or Parquet file with quaternions, several files in sequence, headings alone, or GPS
microseconds."""


@dataclass(frozen=True)
class Recipe:
    """One drive as it is wished for.

    Attributes:
        route: one of `mirror.synth.routes.ROUTES`.
        light: day, dusk or night.
        weather: clear, clouds or rain.
        date: local ISO date.
        vehicle: number of the vehicle.
        poses: how its poses are written.
        pictures: whether it records pictures.
        morning: whether the sun stands in the east.
        dropped: camera and number of a picture that was lost.
    """

    route: str
    light: Light
    weather: Weather
    date: str
    vehicle: int
    poses: PoseStyle = "csv"
    pictures: bool = True
    morning: bool = False
    dropped: tuple[str, int] | None = None


@dataclass(frozen=True)
class ScenePlan:
    """One scene.

    Attributes:
        roi: where.
        yaw_deg: direction of its main street, counter-clockwise from east.
        speed_mps: at which it is driven through.
        extra: drives besides the traversals: the branches of the trigger.
    """

    roi: Roi
    yaw_deg: float
    speed_mps: float
    extra: tuple[Recipe, ...] = ()


@dataclass(frozen=True)
class Preset:
    """A set of recordings.

    Attributes:
        name: its name.
        scenes: the scenes, of which the first so many are recorded.
        traversals: drives with pictures through each scene.
        width_px: of the pictures.
        height_px: of the pictures.
        picture_hz: pictures a second and camera.
        pose_hz: poses a second.
    """

    name: str
    scenes: tuple[ScenePlan, ...]
    traversals: int
    width_px: int
    height_px: int
    picture_hz: float
    pose_hz: float = 20.0


TRAVERSALS: Final = (
    Recipe("along", "day", "clear", "2025-05-14", 0),
    Recipe("back", "night", "clear", "2025-11-19", 1, "parquet", dropped=("rear", 5)),
    Recipe("along", "day", "rain", "2025-06-11", 1, "parts"),
    Recipe("back", "dusk", "clear", "2025-07-02", 0),
    Recipe("turn", "day", "clouds", "2025-10-22", 2, "gps", morning=True),
    Recipe("along", "night", "rain", "2025-12-03", 2),
    Recipe("twice", "day", "clear", "2025-08-20", 1, morning=True),
)
"""Traversals are made in this order, each scene beginning elsewhere, so that scenes differ in what they have."""

_SKIMS: Final = Recipe("corner", "day", "clear", "2025-05-15", 0)
_PASSES_FAST: Final = Recipe("edge", "dusk", "clear", "2025-05-16", 1, "heading", pictures=False)
_STANDS: Final = Recipe("still", "day", "clear", "2025-05-17", 2, "parquet", pictures=False)
_TURNS_ROUND: Final = Recipe("uturn", "night", "clear", "2025-05-18", 1, pictures=False)
_POSES_ONLY: Final = Recipe("back", "day", "clouds", "2025-09-09", 2, "heading", pictures=False)


def _roi(
    scene_id: str,
    longitude_deg: float,
    latitude_deg: float,
    city: str,
    kind: Literal["urban", "campus"],
    radius: float,
    height: float,
) -> Roi:
    return Roi(
        scene_id=scene_id, longitude_deg=longitude_deg, latitude_deg=latitude_deg, radius_m=radius, city=city,
        scene_type=kind, height_m=height,
    )  # fmt: skip


_URBAN: Final = _roi("guangzhou-urban", 113.32446, 23.13188, "Guangzhou", "urban", 200.0, 18.5)
_CAMPUS: Final = _roi("karlsruhe-campus", 8.41694, 49.01252, "Karlsruhe", "campus", 120.0, 162.0)

PRESETS: Final = {
    preset.name: preset
    for preset in (
        Preset(
            "demo",
            (
                ScenePlan(_URBAN, 24.0, 14.0, (_SKIMS, _PASSES_FAST, _STANDS, _TURNS_ROUND)),
                ScenePlan(_CAMPUS, -61.0, 10.0, (_POSES_ONLY,)),
            ),
            traversals=5,
            width_px=400,
            height_px=225,
            picture_hz=0.8,
        ),
        Preset(
            "quick",
            (
                ScenePlan(
                    _URBAN.model_copy(update={"radius_m": 62.0}), 24.0, 9.0,
                    (replace(_SKIMS, pictures=False), _PASSES_FAST, _STANDS, _POSES_ONLY),
                ),
            ),
            traversals=5,
            width_px=320,
            height_px=180,
            picture_hz=0.55,
        ),
        Preset(
            "tiny",
            (ScenePlan(_URBAN.model_copy(update={"radius_m": 62.0}), 24.0, 9.0, (replace(_SKIMS, pictures=False),)),),
            traversals=2,
            width_px=160,
            height_px=90,
            picture_hz=1.0,
        ),
    )
}  # fmt: skip


def planned(
    preset: str, scenes: int | None = None, traversals: int | None = None
) -> tuple[Preset, list[tuple[ScenePlan, list[Recipe]]]]:
    """The drives of a preset, scene by scene.

    Args:
        preset: one of `PRESETS`.
        scenes: how many scenes; default: all that the preset has.
        traversals: how many drives with pictures through each; default: the preset's.

    Raises:
        UsageError: there is no such preset, or it has no so many scenes.
    """
    if preset not in PRESETS:
        raise UsageError(f"no preset {preset!r}", expected=f"one of {', '.join(PRESETS)}")
    wanted = PRESETS[preset]
    count = len(wanted.scenes) if scenes is None else scenes
    if not 1 <= count <= len(wanted.scenes):
        raise UsageError(f"{count} scenes of preset {preset!r}", expected=f"1 to {len(wanted.scenes)}")
    many = wanted.traversals if traversals is None else traversals
    if many < 1:
        raise UsageError(f"{many} traversals a scene", expected="at least 1")
    found = []
    for number, scene in enumerate(wanted.scenes[:count]):
        start = 3 * number % len(TRAVERSALS)
        recipes = list(islice(cycle(TRAVERSALS), start, start + many))
        found.append((scene, [*recipes, *scene.extra]))
    return wanted, found
