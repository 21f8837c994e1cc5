"""Tests of vehicle appearance: a footprint is the mean of its parts."""

from __future__ import annotations

import numpy as np
import pytest

from mirror.arrays import Float64, Records
from mirror.synth.light.lighting import LIGHTING
from mirror.synth.model import FACE, Material, Side
from mirror.synth.model.surfaces import flat
from mirror.synth.render.bodywork import bodywork
from mirror.synth.road_users.coachwork.sheets import Panel

_PARTS = 24


def _face(material: Material, panel: Panel, half: tuple[float, float], seed: int) -> Records:
    one = np.zeros(1, FACE)
    one["colour"], one["half"], one["material"], one["layout"] = (0.3, 0.31, 0.32), half, material, panel
    one["seed"], one["lights"], one["side"] = seed, 1, Side.LEFT
    return one.view(flat(FACE))[0]


def _setting() -> Records:
    setting = np.zeros(1, LIGHTING)
    setting["horizon"], setting["ground_light"], setting["vehicle_lights"] = 0.8, 0.4, 0.2
    return setting.view(flat(LIGHTING))[0]


def _mean(one: Records, u: float, v: float, fu: float, fv: float, setting: Records) -> Float64:
    steps = (np.arange(_PARTS) + 0.5) / _PARTS - 0.5
    parts = [
        bodywork(one, u + a * fu, v + b * fv, fu / _PARTS, fv / _PARTS, setting) for a in steps for b in steps
    ]  # fmt: skip
    return np.asarray(np.mean(parts, axis=0))


@pytest.mark.parametrize(
    ("material", "panel", "half", "most"),
    [
        (Material.PAINT, Panel.FOUR_DOORS, (2.2, 0.5), 0.012),
        (Material.PAINT, Panel.TWO_DOORS, (2.2, 0.5), 0.012),
        (Material.PAINT, Panel.SLIDING_DOOR, (3.0, 0.5), 0.012),
        (Material.PAINT, Panel.ROW, (3.0, 1.2), 0.004),
        (Material.PAINT, Panel.LOWER, (0.8, 0.5), 0.012),
        (Material.GLASS, Panel.FOUR_DOORS, (1.5, 0.2), 0.006),
        (Material.GLASS, Panel.PLAIN, (0.7, 0.4), 0.006),
        (Material.GLASS, Panel.ROW, (4.0, 0.5), 0.004),
        (Material.RIM, Panel.PLAIN, (0.33, 0.33), 0.03),
        (Material.HEADLIGHT, Panel.PLAIN, (0.15, 0.07), 0.02),
        (Material.TAIL_LIGHT, Panel.PLAIN, (0.15, 0.07), 0.02),
    ],
    ids=lambda value: getattr(value, "name", None),
)
def test_footprints_are_means_of_samples(
    material: Material, panel: Panel, half: tuple[float, float], most: float
) -> None:
    rng, setting = np.random.default_rng(3), _setting()
    errors = []
    for trial in range(40):
        one = _face(material, panel, half, trial)
        u, v = rng.uniform(-1.0, 1.0, 2) * half
        fu, fv = 10.0 ** rng.uniform(-2.5, -0.8, 2)
        averaged = np.array(bodywork(one, u, v, fu, fv, setting))
        errors.append(np.abs(averaged - _mean(one, u, v, fu, fv, setting))[:6].max())
    assert np.sqrt(np.mean(np.square(errors))) < most, f"worst {max(errors):.4f}"


@pytest.mark.parametrize(
    "material", [Material.PAINT, Material.GLASS, Material.RIM, Material.HEADLIGHT, Material.RUBBER]
)
def test_appearance_is_finite_and_bounded(material: Material) -> None:
    setting = _setting()
    for footprint in (0.0, 1e-9, 1.0, 1e6):
        for panel in Panel:
            one = _face(material, panel, (0.5, 0.5), 1)
            for u, v in ((0.0, 0.0), (0.5, -0.5), (-1e4, 1e4)):
                appearance = np.array(bodywork(one, u, v, footprint, footprint, setting))
                assert np.isfinite(appearance).all()
                assert (appearance >= 0.0).all()
                assert appearance[:3].max() < 1.0


def test_lamps_emit_light_only_when_switched_on() -> None:
    setting = _setting()
    for material in (Material.HEADLIGHT, Material.TAIL_LIGHT):
        one = np.zeros(1, FACE)
        one["colour"], one["half"], one["material"] = 0.5, 0.1, material
        assert bodywork(one.view(flat(FACE))[0], 0.0, 0.0, 0.01, 0.01, setting)[3:6] == (0.0, 0.0, 0.0)
        one["lights"] = 1
        assert bodywork(one.view(flat(FACE))[0], 0.0, 0.0, 0.01, 0.01, setting)[3] > 0.1
