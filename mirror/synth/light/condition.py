"""When and in what weather a drive takes place, and which effects of that are shown."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Literal

from mirror.errors import UsageError
from mirror.recordings.light import Light

Weather = Literal["clear", "clouds", "rain"]


@dataclass(frozen=True)
class Effects:
    """What is shown of light, weather and camera: each can be left out by itself, so that a cause stands alone.

    Attributes:
        sun_shadows: things keep the sun off each other.
        lamps: street lamps burn in the dark.
        windows: windows and shops are lit in the dark.
        headlights: vehicles burn their lamps.
        wet_road: rain wets the ground, which mirrors.
        haze: air dims and lightens what is far.
        season: plants wear the leaves of the date; else those of midsummer.
        foliage: a few leaves differ from visit to visit.
        billboards: their content differs from visit to visit.
        traffic: there are other road users than parked ones.
        exposure: each camera exposes by what it sees; else all by the condition.
        white_balance: cameras follow the colour of the light, each a little otherwise; else none does.
        vignetting: images darken to their corners.
        noise: of the sensor.
        motion_blur: of the exposure time.
        bloom: glare about lights.
        lens_drops: rain on some lenses.
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
        """Nothing of it: switch on what is asked about with `dataclasses.replace`."""
        return cls(**{effect.name: False for effect in fields(cls)})

    @classmethod
    def without(cls, names: Iterable[str]) -> Effects:
        """All but some.

        Raises:
            UsageError: there is no effect of a name.
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
        light: day, dusk or night, as the sun stands then.
        weather: clear, clouds (overcast) or rain.
        visit: number of the traversal of the scene: what changes between visits goes by it.
        effects: what is shown.
    """

    start_ns: int
    light: Light
    weather: Weather
    visit: int = 0
    effects: Effects = Effects()
