"""The methods that are compared, each with its settings, and ours with parts switched off."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any, Final, TypeVar

import mtgs_style
import omnire_style
import vanilla_3dgs
from benchmarks._reconstruction.declared import declared
from hybridworldsim.methods.static import StaticMethod
from hybridworldsim.methods.street import StreetMethod
from hybridworldsim.methods.street import make as make_street
from hybridworldsim.scene.settings import Rate, Refinement, Settings
from splatting.settings import Splatting

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_T = TypeVar("_T", bound="DataclassInstance")

OURS: Final = "ours"
RIVALS: Final = (vanilla_3dgs, mtgs_style, omnire_style)
_TWO_BLOCKS_M: Final = 70.0
"""Each declared scene has two blocks of this size side by side."""


@dataclass(frozen=True)
class Entry:
    """A row of the comparison.

    Attributes:
        name: of the row.
        method: with its settings.
        group: ``comparison``, ``ablation``, ``seam`` or ``tuning``.
        split: another split than the declared one, of fewer training traversals.
    """

    name: str
    method: StaticMethod
    group: str = "comparison"
    split: str | None = None


def entries() -> dict[str, Entry]:
    """All rows, by name."""
    rows = [
        Entry(OURS, _street(lambda settings: settings)),
        *(
            Entry(f"{package.__name__}-{label}", _explicit(package, settings))
            for package in RIVALS
            for label, settings in (("released", package.RELEASED), ("tuned", package.TUNED))
        ),
        *(Entry(name, _street(change), "ablation") for name, change in _ABLATIONS.items()),
        Entry("two-blocks", replace(_street(_same), block_m=_TWO_BLOCKS_M), "seam"),
        *(Entry(f"{count}-traversals", _street(_same), "ablation", f"novel-{count}") for count in (1, 2)),
        *_trials(),
    ]
    return {row.name: row for row in rows}


def trial(name: str, rates: float, sizes: float) -> str:
    """The name of a method's trial."""
    return f"{name}+rates{rates:g}+sizes{sizes:g}"


def _trials() -> Iterator[Entry]:
    grid = declared().tuning
    for rates, sizes in product(grid.rates, grid.sizes):
        yield Entry(trial(OURS, rates, sizes), _street(partial(scaled_street, rates=rates, sizes=sizes)), "tuning")
        for package in RIVALS:
            settings = scaled_explicit(package.TUNED, rates, sizes)
            yield Entry(trial(package.__name__, rates, sizes), _explicit(package, settings), "tuning")


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


def _as_many_bytes(refinement: Refinement) -> Refinement:
    """Code-Gaussians in place of anchors: 108 bytes each, against 284."""
    return replace(refinement, most_ground=refinement.most_ground + refinement.most * 284 // 108)


def _same(settings: Settings) -> Settings:
    return settings


_ABLATIONS: Final[dict[str, Callable[[Settings], Settings]]] = {
    "no-appearance": lambda settings: replace(settings, latent=0),
    "no-anchors": lambda settings: replace(settings, hybrid=False, refinement=_as_many_bytes(settings.refinement)),
    "no-depth": lambda settings: replace(settings, depth_weight=0.0, normal_weight=0.0),
    "no-normals": lambda settings: replace(settings, normal_weight=0.0),
}


def _street(change: Callable[[Settings], Settings]) -> StaticMethod:
    return StreetMethod("hybridworldsim", make_street, lambda seed: change(replace(Settings(), seed=seed)))


def _explicit(package: Any, settings: Any) -> StaticMethod:
    return StaticMethod(
        package.__name__, package.make, lambda seed: replace(settings, seed=seed), sky=package is omnire_style
    )
