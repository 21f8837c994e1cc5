"""Sun and light against what is known of them, and against the labels that ingest will give."""

import numpy as np
import pytest

from mirror.recordings.light import light_label, solar_elevation_deg
from mirror.synth.fleet import drives_of
from mirror.synth.lighting import Condition, instant_of, lighting, sun_direction


def ns(iso: str) -> int:
    return int(np.datetime64(iso, "ns").astype(np.int64))


def test_sun_rises_in_the_east_at_the_equinox_and_culminates_in_the_south() -> None:
    # 2025-03-20 09:01 UTC is the equinox; at longitude 0 the sun rises about 06:07 and culminates about 12:07.
    rise = sun_direction(ns("2025-03-20T06:07:20"), 0.0, 50.0)
    assert abs(rise[2]) < 0.01
    assert rise[0] > 0.999
    noon = sun_direction(ns("2025-03-20T12:07:20"), 0.0, 50.0)
    assert abs(noon[0]) < 0.005
    assert noon[1] < 0
    assert np.degrees(np.arcsin(noon[2])) == pytest.approx(40.0, abs=0.1)


@pytest.mark.parametrize(("longitude", "latitude"), [(0.0, 0.0), (113.3, 23.1), (-70.0, -53.0), (15.6, 78.2)])
def test_sun_direction_is_a_unit_vector_at_the_stated_elevation(longitude: float, latitude: float) -> None:
    stamps = ns("2025-01-01") + np.arange(0, 365 * 24, 7) * 3_600_000_000_000
    sun = sun_direction(stamps, longitude, latitude)
    assert np.abs(np.linalg.norm(sun, axis=1) - 1).max() < 1e-11
    elevation = solar_elevation_deg(stamps, longitude, latitude)
    assert np.abs(np.degrees(np.arcsin(sun[:, 2])) - elevation).max() < 1e-6


@pytest.mark.parametrize("light", ["day", "dusk", "night"])
@pytest.mark.parametrize("morning", [True, False])
def test_an_instant_has_the_light_that_was_asked_for(light: str, morning: bool) -> None:
    for date in ("2025-01-15", "2025-06-21", "2025-10-30"):
        for place in ((113.3, 23.1), (8.4, 49.0), (-122.0, 37.0)):
            instant = instant_of(date, light, *place, morning=morning)
            assert light_label(float(solar_elevation_deg(instant, *place))) == light
            assert (sun_direction(instant, *place)[0] > 0) == morning or light == "night"


def test_every_drive_keeps_its_light_from_start_to_end() -> None:
    for preset in ("demo", "quick", "tiny"):
        for drive in drives_of(preset, 0)[1]:
            roi = drive.world.roi
            for instant in (0.0, drive.truth.duration_s):
                stamp = drive.condition.start_ns + int(instant * 1e9)
                elevation = float(solar_elevation_deg(stamp, roi.longitude_deg, roi.latitude_deg))
                assert light_label(elevation) == drive.recipe.light, drive.drive_id


def test_lamps_burn_in_the_dark_and_shadows_need_the_sun() -> None:
    def look(light: str, weather: str) -> np.ndarray:
        return lighting(Condition(instant_of("2025-05-10", light, 8.4, 49.0), light, weather), 8.4, 49.0)

    day, rain, dusk, night = look("day", "clear"), look("day", "rain"), look("dusk", "clear"), look("night", "clear")
    assert day["sunlight"].min() > 0.5
    assert not any(one["sunlight"].any() for one in (rain, dusk, night))
    assert day["headlight"] == rain["headlight"] == 0.0 < night["headlight"]
    assert not day["lamp_light"].any()
    assert night["lamp_light"].all()
    assert rain["wet"] == 1.0
    assert day["zenith"].sum() > dusk["zenith"].sum() > night["zenith"].sum()
