"""The time and weather of a drive, and the effects of light, weather and camera that are rendered."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Literal

from mirror.errors import UsageError
from mirror.recordings.light import Light

Weather = Literal["clear", "clouds", "rain"]


@dataclass(frozen=True)
class Effects:
    """The rendered effects of light, weather and camera. Each can be switched off, to study one cause at a time.

    Attributes:
        sun_shadows: shadows of the sun.
        lamps: street lamps are on in the dark.
        windows: windows and shops are lit in the dark.
        headlights: the lamps of vehicles are on in the dark.
        wet_road: rain makes the ground wet and reflective.
        haze: haze reduces the contrast of distant objects.
        season: leaves follow the date; otherwise they are those of midsummer.
        foliage: a few leaves differ between visits.
        billboards: the content of billboards differs between visits.
        traffic: moving road users are present; otherwise only the parked ones.
        exposure: each camera exposes by its image; otherwise all cameras expose by the condition.
        white_balance: each camera follows the colour of the light, with small differences; otherwise none does.
        vignetting: images are darker towards the corners.
        noise: sensor noise.
        motion_blur: motion blur of the exposure time.
        bloom: glare around lights.
        lens_drops: rain drops on some lenses.
    """

    sun_shadows: bool = True
    lamps: bool = True
    windows: bool = True
    headlights: bool = True
    wet_road: bool = True
    haze: bool = True
    season: bool = True
    foliage: bool = True
    billboards: bool = True
    traffic: bool = True
    exposure: bool = True
    white_balance: bool = True
    vignetting: bool = True
    noise: bool = True
    motion_blur: bool = True
    bloom: bool = True
    lens_drops: bool = True

    @classmethod
    def none(cls) -> Effects:
        """Return effects that are all off; switch single effects on with `dataclasses.replace`."""
        return cls(**{effect.name: False for effect in fields(cls)})

    @classmethod
    def without(cls, names: Iterable[str]) -> Effects:
        """Return all effects except the named ones.

        Raises:
            UsageError: a name is not the name of an effect.
        """
        known, missing = [effect.name for effect in fields(cls)], tuple(names)
        for name in missing:
            if name not in known:
                raise UsageError(f"no effect {name!r}", expected="some of " + ", ".join(known))
        return cls(**dict.fromkeys(missing, False))


@dataclass(frozen=True)
class Condition:
    """Light and weather of one drive.

    Attributes:
        start_ns: Unix time of the drive's start.
        light: day, dusk or night, by the elevation of the sun.
        weather: clear, clouds (overcast) or rain.
        visit: number of the traversal of the scene; it selects what changes between visits.
        effects: effects to be rendered.
    """

    start_ns: int
    light: Light
    weather: Weather
    visit: int = 0
    effects: Effects = Effects()
