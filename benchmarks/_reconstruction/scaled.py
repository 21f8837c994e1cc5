"""Settings with all learning rates, or all numbers of Gaussians, times something: the cells of the tuning's grid."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, TypeVar

from hybridworldsim.scene.settings import Rate, Settings
from splatting.settings import Splatting

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_T = TypeVar("_T", bound="DataclassInstance")


def scaled_street(settings: Settings, rates: float, sizes: float) -> Settings:
    """Our settings with all learning rates and all numbers of Gaussians times something."""
    grown = settings.refinement
    return replace(
        settings,
        rates=_faster(settings.rates, rates),
        first_anchors=round(sizes * settings.first_anchors),
        refinement=replace(
            grown,
            most=round(sizes * grown.most),
            most_ground=round(sizes * grown.most_ground),
            most_sky=round(sizes * grown.most_sky),
        ),
    )


def scaled_explicit(settings: Splatting, rates: float, sizes: float) -> Splatting:
    """A rival's settings with all learning rates and all numbers of Gaussians times something."""
    seeding, density = settings.seeding, settings.densification
    return replace(
        _faster(settings, rates),
        rates=_faster(settings.rates, rates),
        seeding=replace(seeding, most=round(sizes * seeding.most)),
        densification=replace(density, most=round(sizes * density.most)),
    )


def _faster(settings: _T, times: float) -> _T:
    """Settings whose learning rates are times something."""
    own = {field.name: getattr(settings, field.name) for field in fields(settings)}
    rates = {name: rate for name, rate in own.items() if isinstance(rate, Rate)}
    return replace(settings, **{name: Rate(times * rate.first, times * rate.last) for name, rate in rates.items()})
