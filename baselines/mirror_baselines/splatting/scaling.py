"""Scales all learning rates or all numbers of Gaussians of settings, for the cells of the tuning grid."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, TypeVar

from hybridworldsim.model.settings import Rate
from mirror_baselines.splatting.settings import Splatting

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_T = TypeVar("_T", bound="DataclassInstance")
_Settings = TypeVar("_Settings", bound=Splatting)


def scale_splatting(settings: _Settings, rates: float, sizes: float) -> _Settings:
    """Multiply all learning rates by `rates` and all numbers of Gaussians by `sizes`."""
    seeding, density = settings.seeding, settings.densification
    return replace(
        scale_rates(settings, rates),
        rates=scale_rates(settings.rates, rates),
        seeding=replace(seeding, most=round(sizes * seeding.most)),
        densification=replace(density, most=round(sizes * density.most)),
    )


def with_seed(settings: _Settings, seed: int) -> _Settings:
    """Return settings with another seed."""
    return replace(settings, seed=seed)


def scale_counts(settings: _Settings, factor: float) -> _Settings:
    """Multiply all numbers of Gaussians by a factor; initial points and grids are denser to match."""
    scaled, closer = scale_splatting(settings, 1.0, factor), factor**-0.5
    seeding = scaled.seeding
    return replace(
        scaled,
        seeding=replace(
            seeding,
            spacing_m=closer * seeding.spacing_m,
            share=closer * seeding.share,
            ground_spacing_m=closer * seeding.ground_spacing_m,
            sky_count=round(factor * seeding.sky_count),
            far_count=round(factor * seeding.far_count),
        ),
        densification=replace(scaled.densification, split_m=closer * scaled.densification.split_m),
    )


def scale_rates(settings: _T, times: float) -> _T:
    """Multiply the learning rates of a dataclass by a factor."""
    values = {field.name: getattr(settings, field.name) for field in fields(settings)}
    rates = {name: rate for name, rate in values.items() if isinstance(rate, Rate)}
    return replace(settings, **{name: Rate(times * rate.first, times * rate.last) for name, rate in rates.items()})
