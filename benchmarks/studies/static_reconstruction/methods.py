"""The methods that are compared, each with its settings, and ours with parts switched off."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import product
from typing import Any, Final

from benchmarks.studies.static_reconstruction.choices import BASELINE_CHOICES, OWN_CHOICES, baseline_name, choice
from benchmarks.studies.static_reconstruction.declaration import load_declaration
from benchmarks.studies.static_reconstruction.equal_bytes import with_equal_bytes
from benchmarks.studies.static_reconstruction.scaling import scale_settings
from hybridworldsim.methods.overrides import settings_document
from hybridworldsim.methods.static import StaticMethod
from hybridworldsim.methods.street import STRUCTURE_WEIGHT, StreetMethod
from hybridworldsim.methods.street import make as make_street
from hybridworldsim.model.settings import AnchorRefinement, Settings
from mirror_baselines import mtgs_style, omnire_style, vanilla_3dgs
from mirror_baselines.splatting.scaling import scale_splatting

OURS: Final = "ours"
STRUCTURE: Final = "ours-structure"
"""With a loss of structure, which the paper does not have."""

SINGLE: Final = "omnire_style-single"
"""OmniRe-style trained on the traversal nearest to the held-out one alone, as OmniRe is meant to be used."""

EQUAL_BYTES_EXPOSED: Final = choice("mtgs_style-bytes", "exposure")
"""MTGS-style with as many bytes as ours, and an exposure for each training image."""

BASELINES: Final = (vanilla_3dgs, mtgs_style, omnire_style)
WIDER: Final[Mapping[str, tuple[tuple[float, float], ...]]] = {
    "vanilla_3dgs": ((1.0, 4.0),),
    "mtgs_style": ((1.0, 4.0), (2.0, 4.0), (4.0, 2.0)),
    "omnire_style": ((2.0, 4.0), (4.0, 2.0)),
}
"""Cells beyond the grid's edge that baselines try too, since their best cells lie on the edge."""
REDUCED_COUNTS: Final = (1, 2)
"""Numbers of training traversals of the rows that have fewer."""
OURS_REPEATED: Final = "4-traversals"
"""Ours trained once more within the hours of the ablations: the speed of a core differs between hours."""
_TWO_BLOCKS_M: Final = 70.0
"""Each declared scene has two blocks of this size side by side."""


@dataclass(frozen=True)
class Entry:
    """A row of the comparison.

    Attributes:
        name: of the row.
        method: with its settings.
        split: another split than the declared one, of fewer training traversals.
    """

    name: str
    method: StaticMethod
    split: str | None = None

    def settings(self, seed: int) -> dict[str, Any]:
        """Return every number of the method, and its split if that is not the declared one, as JSON has it."""
        whole = {
            "method": self.method.name,
            "block_m": self.method.block_m,
            **settings_document(self.method.settings(seed)),
        }
        if self.split is not None:
            whole["split"] = self.split
        known: dict[str, Any] = json.loads(json.dumps(whole))
        return known


@cache
def entries() -> Mapping[str, Entry]:
    """Return all rows, by name."""
    declared_split = load_declaration().split
    rows = [
        Entry(OURS, _street(_same)),
        Entry(STRUCTURE, _street(_with_structure)),
        *(
            Entry(f"{baseline_name(package)}-{label}", _explicit(package, settings))
            for package in BASELINES
            for label, settings in (("released", package.RELEASED), ("tuned", package.TUNED))
        ),
        *(
            Entry(f"{baseline_name(package)}-bytes", _explicit(package, with_equal_bytes(package.TUNED)))
            for package in BASELINES
        ),
        Entry(EQUAL_BYTES_EXPOSED, _explicit(mtgs_style, _exposed(with_equal_bytes(mtgs_style.TUNED)))),
        *(Entry(name, _street(change)) for name, change in _ABLATIONS.items()),
        Entry("two-blocks", replace(_street(_same), block_m=_TWO_BLOCKS_M)),
        *(
            Entry(f"{count}-traversals", _street(_same), reduced_split(load_declaration().split, count))
            for count in REDUCED_COUNTS
        ),
        Entry(OURS_REPEATED, _street(_same)),
        Entry(SINGLE, _explicit(omnire_style, omnire_style.TUNED), reduced_split(declared_split, 1)),
        *trials().values(),
    ]
    return {row.name: row for row in rows}


def reduced_split(split: str, traversals: int) -> str:
    """Return the name of a split of so many training traversals a scene, those nearest to the held-out one."""
    return f"{split}-{traversals}"


def trial(name: str, rates: float, sizes: float) -> str:
    """Return the name of a method's trial."""
    return f"{name}+rates{rates:g}+sizes{sizes:g}"


def trials() -> Mapping[str, Entry]:
    """List all trials of the tuning by name.

    They are the grid, cells beyond its edge for baselines, and single choices changed.
    """
    return {row.name: row for row in _trials()}


def _trials() -> Iterator[Entry]:
    grid = load_declaration().tuning
    cells = list(product(grid.rates, grid.sizes))
    for rates, sizes in cells:
        yield Entry(trial(OURS, rates, sizes), _street(partial(scale_settings, rates=rates, sizes=sizes)))
    for name, change in OWN_CHOICES.items():
        yield Entry(choice(OURS, name), _street(change))
    for package in BASELINES:
        for rates, sizes in (*cells, *WIDER[baseline_name(package)]):
            settings = scale_splatting(package.BY_HAND, rates, sizes)
            yield Entry(trial(baseline_name(package), rates, sizes), _explicit(package, settings))
        for name, change in BASELINE_CHOICES[baseline_name(package)].items():
            yield Entry(choice(baseline_name(package), name), _explicit(package, change(package.TUNED)))


def _as_many_bytes(settings: Settings) -> AnchorRefinement:
    """Code-Gaussians in place of anchors: 27 numbers each, against 50."""
    grown, anchor, plain = settings.refinement, 9 + 3 * settings.offsets + settings.code, 11 + settings.plain_code
    return replace(grown, most_ground=grown.most_ground + grown.max_anchors * anchor // plain)


def _with_structure(settings: Settings) -> Settings:
    return replace(settings, structure_weight=STRUCTURE_WEIGHT)


def _exposed(settings: Any) -> Any:
    return BASELINE_CHOICES[baseline_name(mtgs_style)]["exposure"](settings)


def _same(settings: Settings) -> Settings:
    return settings


_ABLATIONS: Final[dict[str, Callable[[Settings], Settings]]] = {
    "no-appearance": lambda settings: replace(settings, latent=0),
    "no-anchors": lambda settings: replace(settings, hybrid=False, refinement=_as_many_bytes(settings)),
    "no-depth": lambda settings: replace(settings, depth_weight=0.0, normal_weight=0.0),
    "no-normals": lambda settings: replace(settings, normal_weight=0.0),
}


def _street(change: Callable[[Settings], Settings]) -> StaticMethod:
    return StreetMethod("hybridworldsim", make_street, lambda seed: change(replace(Settings(), seed=seed)))


def _explicit(package: Any, settings: Any) -> StaticMethod:
    return StaticMethod(
        baseline_name(package),
        package.make,
        lambda seed: replace(settings, seed=seed),
        sky=package is omnire_style,
        make_empty=package.make_empty,
    )
