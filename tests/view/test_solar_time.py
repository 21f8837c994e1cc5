"""Local solar time beside UTC."""

from __future__ import annotations

from mirror.view.images import solar_time


def test_solar_time_follows_the_longitude() -> None:
    noon_ns = 1_750_000_000 // 86400 * 86400 * 10**9 + 43200 * 10**9
    assert solar_time(noon_ns, {"bbox": {"xmin": 0.0}}) == "12:00"
    assert solar_time(noon_ns, {"bbox": {"xmin": 113.25}}) == "19:33"
    assert solar_time(noon_ns, {"bbox": {"xmin": -90.0}}) == "06:00"
    assert solar_time(noon_ns, {"bbox": None}) == ""
