"""Tests that each effect can be switched off separately."""

from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest

from mirror.synth.light.condition import Condition, Effects
from mirror.synth.light.lighting import LIGHTING, Lighting, compute_lighting
from mirror.synth.light.sun import instant_of

PLACE = (8.4, 49.0)
OWN = {
    "sun_shadows": {"shadows"},
    "lamps": {"lamp_light"},
    "windows": {"lit_windows"},
    "headlights": {"headlight", "vehicle_lights"},
    "wet_road": {"wet"},
    "haze": {"haze_per_m"},
    "season": {"season"},
}


ALL = Effects()


def condition(light: str, weather: str, effects: Effects = ALL) -> Condition:
    return Condition(instant_of("2025-05-10", light, *PLACE), light, weather, 3, effects)


@cache
def lighting_of(light: str, weather: str, effects: Effects = ALL) -> Lighting:
    return compute_lighting(condition(light, weather, effects), *PLACE)


def test_effects_none_disables_all_and_default_enables_all() -> None:
    for effect in fields(Effects):
        assert getattr(Effects(), effect.name) is True
        assert getattr(Effects.none(), effect.name) is False


@pytest.mark.parametrize("effect", [effect.name for effect in fields(Effects)])
def test_an_effect_changes_only_its_own_fields(effect: str) -> None:
    for light, weather in (("night", "rain"), ("day", "clear")):
        whole = lighting_of(light, weather)
        without = lighting_of(light, weather, replace(ALL, **{effect: False}))
        changed = {name for name in LIGHTING.names if not np.array_equal(whole.record[name], without.record[name])}
        assert changed <= OWN.get(effect, set())
        assert np.array_equal(whole.dome, without.dome)
    if effect in OWN and effect not in ("sun_shadows", "season"):
        night = lighting_of("night", "rain", replace(ALL, **{effect: False})).record
        assert all(not np.any(night[name]) for name in OWN[effect])


def test_lamps_are_lit_in_the_dark_and_shadows_need_the_sun() -> None:
    day, rain, dusk, night = (
        lighting_of(*what).record for what in (("day", "clear"), ("day", "rain"), ("dusk", "clear"), ("night", "clear"))
    )
    assert day["sunlight"].min() > 0.5
    assert not any(one["sunlight"].any() for one in (rain, dusk, night))
    assert day["headlight"] == 0.0 < rain["headlight"] < night["headlight"]
    assert not day["lamp_light"].any()
    assert night["lamp_light"].all()
    assert rain["wet"] == 1.0
    assert day["sky_light"].sum() > dusk["sky_light"].sum() > night["sky_light"].sum()


def test_visits_change_clouds_but_not_light() -> None:
    first, again, second = (
        compute_lighting(replace(condition("day", "clear"), visit=visit), *PLACE).record for visit in (1, 1, 2)
    )
    assert first.tobytes() == again.tobytes()
    assert not np.array_equal(first["cloud_shift"], second["cloud_shift"])
    assert first["sunlight"].tolist() == second["sunlight"].tolist()
    assert first["sky_light"] == pytest.approx(second["sky_light"], rel=0.15)
