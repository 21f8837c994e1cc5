"""Single choices beside rates and sizes: those of baselines set back to the released ones, and some of ours."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import ModuleType
from typing import Any, Final

from hybridworldsim.model.settings import Settings
from mirror_baselines import mtgs_style, omnire_style, vanilla_3dgs
from mirror_baselines.splatting.scaling import scale_rates
from mirror_baselines.splatting.settings import Weights

AS_TUNED: Final = "as-tuned"
"""The tuned settings unchanged, trained within the hours of the other choices."""


def baseline_name(package: ModuleType) -> str:
    """Return the name of a baseline: that of its package."""
    return package.__name__.rpartition(".")[2]


def _absolute_errors(settings: Any) -> Any:
    released = Weights()
    colours = {"structure": released.structure, "pixelwise": released.pixelwise}
    return replace(settings, weights=replace(settings.weights, **colours))


BASELINE_CHOICES: Final[Mapping[str, Mapping[str, Callable[[Any], Any]]]] = {
    baseline_name(vanilla_3dgs): {
        AS_TUNED: lambda settings: settings,
        "l1": _absolute_errors,
        "no-depth": lambda settings: replace(settings, weights=replace(settings.weights, depth=0.0)),
        "resets": lambda settings: replace(
            settings, densification=replace(settings.densification, resets=vanilla_3dgs.RELEASED.densification.resets)
        ),
    },
    baseline_name(mtgs_style): {
        AS_TUNED: lambda settings: settings,
        "l1": _absolute_errors,
        "exposure": lambda settings: replace(settings, exposure=mtgs_style.RELEASED.exposure),
        "no-constant": lambda settings: replace(settings, rates=replace(settings.rates, adapter=None)),
        "degree3": lambda settings: replace(settings, sh_degree=mtgs_style.RELEASED.sh_degree),
        "inverse-depth": lambda settings: replace(
            settings,
            weights=replace(
                settings.weights,
                depth=mtgs_style.RELEASED.weights.depth,
                depth_kind=mtgs_style.RELEASED.weights.depth_kind,
            ),
        ),
    },
    baseline_name(omnire_style): {
        AS_TUNED: lambda settings: settings,
        "l1": _absolute_errors,
        "degree3": lambda settings: replace(settings, sh_degree=omnire_style.RELEASED.sh_degree),
        "slow-affine": lambda settings: replace(settings, affine=omnire_style.RELEASED.affine),
    },
}
"""Changes of the baselines' tuned settings, by method and name."""


def _grown_until(settings: Settings, end: float) -> Settings:
    return replace(settings, refinement=replace(settings.refinement, end=end))


OWN_CHOICES: Final[Mapping[str, Callable[[Settings], Settings]]] = {
    AS_TUNED: lambda settings: settings,
    "depth-as-rivals": lambda settings: replace(settings, depth_weight=0.02),
    "no-normals": lambda settings: replace(settings, normal_weight=0.0),
    "fast-looks": lambda settings: replace(
        settings, rates=replace(settings.rates, latents=scale_rates(settings.rates, 2.0).latents)
    ),
    "grown-longer": lambda settings: _grown_until(settings, 0.8),
}
"""Changes of our settings; with the grid, ours has no more trials than any baseline."""


def choice(method: str, name: str) -> str:
    """Return the name of the row of a choice."""
    return f"{method}+{name}"
