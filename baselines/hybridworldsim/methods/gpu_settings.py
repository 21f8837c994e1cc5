"""Settings for a GPU: as many more Gaussians than on a CPU as its default images have more pixels to show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Final

from hybridworldsim.methods.overrides import settings_document
from hybridworldsim.model.settings import Settings

FULL_WIDTH_PX: Final = 960
_AT_FULL_WIDTH: Final = 10.0
"""At 960 pixels a street has 360,000 anchors with a million Gaussians, for which the goals of frame rates hold."""


def size_factor(width_px: int | None) -> float:
    """Return the factor of the numbers of Gaussians on a GPU: ten at 960 pixels, less at a lower width, at least one.

    Args:
        width_px: width of the training images; None: they are not scaled down.
    """
    share = 1.0 if width_px is None else width_px / FULL_WIDTH_PX
    return max(1.0, _AT_FULL_WIDTH * share**2)


def scale_street(settings: Settings, factor: float) -> Settings:
    """Multiply the numbers of anchors and Gaussians of a street; initial points and grids are denser to match."""
    refinement, closer = settings.refinement, factor**-0.5
    return replace(
        settings,
        first_anchors=round(factor * settings.first_anchors),
        first_spacing_m=closer * settings.first_spacing_m,
        first_share=closer * settings.first_share,
        ground_spacing_m=closer * settings.ground_spacing_m,
        sky_count=round(factor * settings.sky_count),
        far_count=round(factor * settings.far_count),
        refinement=replace(
            refinement,
            max_anchors=round(factor * refinement.max_anchors),
            most_ground=round(factor * refinement.most_ground),
            most_sky=round(factor * refinement.most_sky),
            cells_m=tuple(closer * size_m for size_m in refinement.cells_m),
            least_cell=closer * refinement.least_cell,
        ),
    )


def describe_changes(before: Any, after: Any) -> str:
    """Return the settings that differ, as ``name=value`` pairs of the later ones."""
    pairs = zip(_leaves(settings_document(before)), _leaves(settings_document(after)), strict=True)
    return ", ".join(f"{name}={_short(new)}" for (name, old), (_, new) in pairs if old != new)


def _short(value: Any) -> str:
    return " ".join(f"{number:.3g}" for number in value) if isinstance(value, list) else f"{value:.6g}"


def _leaves(document: Mapping[str, Any], under: str = "") -> list[tuple[str, Any]]:
    found: list[tuple[str, Any]] = []
    for key, value in document.items():
        found += _leaves(value, f"{under}{key}.") if isinstance(value, dict) else [(f"{under}{key}", value)]
    return found
