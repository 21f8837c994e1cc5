"""Local solar time beside UTC."""

from __future__ import annotations

from pathlib import Path

from mirror.dataset.times import longitude_of, solar_time, utc_and_solar
from mirror.recordings.light import solar_elevation_deg
from mirror.schema.index_tables import TRAVERSALS

NOON_NS = 1_750_000_000 // 86400 * 86400 * 10**9 + 43200 * 10**9


def test_solar_time_follows_the_longitude() -> None:
    assert solar_time(NOON_NS, 0.0) == "12:00"
    assert solar_time(NOON_NS, 113.25) == "19:33"
    assert solar_time(NOON_NS, -90.0) == "06:00"
    assert solar_time(NOON_NS, None) == ""


def test_the_sun_is_highest_at_solar_noon() -> None:
    """The equation of time shifts the true noon by 17 minutes at most."""
    for longitude_deg in (-71.25, 8.4, 113.25):
        stamps = [NOON_NS + minute * 60 * 10**9 for minute in range(-720, 720)]
        highest = max(stamps, key=lambda stamp: float(solar_elevation_deg(stamp, longitude_deg, 40.0)))
        hours, minutes = map(int, solar_time(highest, longitude_deg).split(":"))
        assert abs(60 * hours + minutes - 720) <= 17


def test_utc_stands_beside_the_solar_time_where_the_place_is_known() -> None:
    assert "bbox" in TRAVERSALS.schema.names
    assert (
        utc_and_solar(NOON_NS, longitude_of({"bbox": {"xmin": 113.25}})) == "2025-06-15 12:00:00 UTC (19:33 solar time)"
    )
    assert utc_and_solar(NOON_NS, longitude_of({"bbox": None})) == "2025-06-15 12:00:00 UTC"


def test_no_page_shows_utc_by_itself_beside_a_word_of_light() -> None:
    """Modules that print the light of a traversal and its time print the solar time, too."""
    view = Path(__file__).resolve().parents[2] / "mirror" / "view"
    for path in view.glob("*.py"):
        text = path.read_text()
        if "utc(" in text and ('"light"' in text or "['light']" in text):
            assert "solar" in text, path.name
