"""Recall of regions on the synthetic street by light and size, and the share of pixels that is covered for nothing."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np

from benchmarks.privacy.outcomes import Outcome, Thing
from benchmarks.report import Row
from mirror.privacy.operators import Redaction
from mirror.privacy.propagation.vehicles import StripOptions, plate_strips
from mirror.privacy.regions import KINDS, Kind, covered_share, grown_box, region_mask

FACE_EDGES_PX: Final = (8.0, 16.0, 24.0, 48.0, np.inf)
PLATE_EDGES_PX: Final = (16.0, 32.0, 48.0, np.inf)
COVERED: Final = 0.9
LEAST_SEEN: Final[dict[Kind, float]] = {"face": 0.6, "plate": 0.85}
MISSED_BARS: Final = {("face", False, 16.0): 5.0, ("plate", False, 48.0): 10.0, ("plate", True, 32.0): 2.0}
"""Largest share of missed regions from a size on, in percent, by kind and whether the fallback is on."""
_OUTSIDE_BAR: Final = 5.0


@dataclass
class Tally:
    """Counts of plates and faces in the images of one light.

    Attributes:
        strips: options of the fallback.
        sizes_px: sizes of true regions, by kind.
        found: whether each is covered by 90 %, by kind and whether the fallback is on.
        outside: share of pixels outside of true regions that is covered, a value an image.
    """

    strips: StripOptions = field(default_factory=StripOptions)
    sizes_px: dict[Kind, list[float]] = field(default_factory=lambda: defaultdict(list))
    found: dict[tuple[Kind, bool], list[bool]] = field(default_factory=lambda: defaultdict(list))
    outside: dict[bool, list[float]] = field(default_factory=lambda: defaultdict(list))

    def add(self, outcome: Outcome, how: Redaction, *, plates_only: bool = False) -> None:
        """Count an image.

        Args:
            outcome: what was found in it.
            how: margins of the redaction.
            plates_only: the image is there for the recall of its plates: neither faces nor what is covered counts.
        """
        height, width = outcome.height_px, outcome.width_px
        kinds: tuple[Kind, ...] = ("plate",) if plates_only else KINDS
        for kind in kinds:
            self.sizes_px[kind] += [_size_px(kind, one) for one in outcome.things(kind) if one.seen >= LEAST_SEEN[kind]]
        detected = list(outcome.regions)
        for fallback in (False, True):
            regions = detected + (
                plate_strips(outcome.camera, *outcome.boxes, detected, self.strips, grow=how.grow) if fallback else []
            )
            for kind in kinds:
                own = [one for one in regions if one.kind == kind]
                boxes = [box for one in own if (box := grown_box(one, how.grow, width, height)) is not None]
                for thing in outcome.things(kind):
                    if thing.seen >= LEAST_SEEN[kind]:
                        true = np.clip(thing.box_px, 0.0, [width, height, width, height])
                        self.found[kind, fallback].append(covered_share(true.tolist(), boxes) >= COVERED)
            if plates_only:
                continue
            inside = np.zeros((height, width), np.bool_)
            for thing in (*outcome.faces, *outcome.plates):
                left, top, right, bottom = np.clip(thing.box_px, 0.0, [width, height, width, height])
                inside[math.floor(top) : math.ceil(bottom), math.floor(left) : math.ceil(right)] = True
            covered = region_mask(regions, how.grow, width, height)
            self.outside[fallback].append(float((covered & ~inside).sum() / (~inside).sum()))

    def rows(self, light: str) -> Iterator[Row]:
        """Yield the share of missed regions by kind and size, its upper bound, and the area covered beside."""
        edges_px: dict[Kind, Sequence[float]] = {"face": FACE_EDGES_PX, "plate": PLATE_EDGES_PX}
        for kind, edges in edges_px.items():
            for fallback in (False, True) if kind == "plate" else (False,):
                for low, high in pairwise(edges):
                    yield from self._missed(light, kind, fallback, (low, high), None)
                for (own, on, low), bar in MISSED_BARS.items():
                    if (own, on) == (kind, fallback):
                        yield from self._missed(light, kind, fallback, (low, np.inf), bar)
        for fallback in (False, True):
            yield from self._covered(light, fallback, _OUTSIDE_BAR)

    def fallback_rows(self, case: str) -> Iterator[Row]:
        """Yield the share of plates from 32 px that are missed with the fallback, and the covered area."""
        yield from self._missed(case, "plate", True, (32.0, np.inf), None)
        yield from self._covered(case, True, None)

    def _covered(self, case: str, fallback: bool, bar: float | None) -> Iterator[Row]:
        values = self.outside[fallback]
        if values:
            name = f"{case}: outside of true regions covered{', with fallback' if fallback else ''} (%)"
            yield Row(name, f"{len(values)} images", 100.0 * float(np.mean(values)), bar=bar)

    def _missed(
        self, case: str, kind: Kind, fallback: bool, span_px: tuple[float, float], bar: float | None
    ) -> Iterator[Row]:
        """The row of a cell; none if it has no regions."""
        sizes, found = np.array(self.sizes_px[kind]), np.array(self.found[kind, fallback], np.bool_)
        low, high = span_px
        these = (sizes >= low) & (sizes < high)
        count, missed = int(these.sum()), int((these & ~found).sum())
        if count:
            span = f"{low:.0f} px and more" if np.isinf(high) else f"{low:.0f} to {high:.0f} px"
            name = f"{case}, {kind}s{', with fallback' if fallback else ''}, {span}: missed (%)"
            bound = 100.0 * upper_bound(missed, count)
            yield Row(name, f"{count} regions", 100.0 * missed / count, bound, unit="% (95 % bound)", bar=bar)


def _size_px(kind: Kind, thing: Thing) -> float:
    """Height of a face, width of a plate."""
    left, top, right, bottom = thing.box_px
    return bottom - top if kind == "face" else right - left


def upper_bound(missed: int, count: int) -> float:
    """Return the one-sided Clopper-Pearson bound of a share, 95 %."""
    from scipy.stats import beta

    return 1.0 if missed >= count else float(beta.ppf(0.95, missed + 1, count - missed))
