"""The geographic positions of the scenes: they set the sun, the seasons and the map grids. The streets are invented."""

from __future__ import annotations

from typing import Final, Literal, NamedTuple

from mirror.schema.documents import Roi

Kind = Literal["urban", "highway", "rural", "campus"]


class _City(NamedTuple):
    name: str
    longitude_deg: float
    latitude_deg: float
    height_m: float


_GUANGZHOU: Final = _City("Guangzhou", 113.32446, 23.13188, 18.5)
_KARLSRUHE: Final = _City("Karlsruhe", 8.41694, 49.01252, 162.0)
_LYON: Final = _City("Lyon", 4.85064, 45.76031, 219.0)
_TORONTO: Final = _City("Toronto", -79.41236, 43.66412, 74.0)
_SANTIAGO: Final = _City("Santiago", -70.63251, -33.43147, 612.0)
_WUHAN: Final = _City("Wuhan", 114.36114, 30.53928, 11.0)


def _make_scene(city: _City, kind: Kind, east_deg: float = 0.0, north_deg: float = 0.0) -> Roi:
    return Roi(
        scene_id=f"{city.name.lower()}-{kind}",
        longitude_deg=round(city.longitude_deg + east_deg, 5),
        latitude_deg=round(city.latitude_deg + north_deg, 5),
        radius_m=200.0,
        city=city.name,
        scene_type=kind,
        height_m=city.height_m,
    )


GUANGZHOU_URBAN: Final = _make_scene(_GUANGZHOU, "urban")
GUANGZHOU_HIGHWAY: Final = _make_scene(_GUANGZHOU, "highway", 0.09, 0.07)
KARLSRUHE_CAMPUS: Final = _make_scene(_KARLSRUHE, "campus")
KARLSRUHE_RURAL: Final = _make_scene(_KARLSRUHE, "rural", 0.11, -0.06)
LYON_URBAN: Final = _make_scene(_LYON, "urban")
LYON_HIGHWAY: Final = _make_scene(_LYON, "highway", 0.12, 0.04)
TORONTO_URBAN: Final = _make_scene(_TORONTO, "urban")
TORONTO_RURAL: Final = _make_scene(_TORONTO, "rural", -0.21, 0.19)
SANTIAGO_URBAN: Final = _make_scene(_SANTIAGO, "urban")
WUHAN_CAMPUS: Final = _make_scene(_WUHAN, "campus")


def with_radius(roi: Roi, radius_m: float) -> Roi:
    """Return a region of interest with another radius."""
    return roi.model_copy(update={"radius_m": radius_m})
