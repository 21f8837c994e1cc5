"""Recall of regions on the synthetic street by light and size, and the share of pixels that is covered for nothing."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Final

import numpy as np

from benchmarks.report import Row
from benchmarks.synth_detectors.crowd import CrowdImage, Target
from mirror.privacy.detectors.protocol import Detector
from mirror.privacy.operators import Redaction
from mirror.privacy.propagation.vehicles import plate_strips
from mirror.privacy.regions import Kind, Region, covered_share, grown_box, merged, region_mask
from mirror.synth.writing.boxes import world_SE3_boxes

FACE_EDGES_PX: Final = (8.0, 16.0, 24.0, 48.0, np.inf)
PLATE_EDGES_PX: Final = (16.0, 32.0, 48.0, np.inf)
COVERED: Final = 0.9
LEAST_SEEN: Final[dict[Kind, float]] = {"face": 0.6, "plate": 0.85}
MISSED_BARS: Final = {("face", False, 16.0): 5.0, ("plate", False, 48.0): 10.0, ("plate", True, 32.0): 2.0}
"""Largest share of missed regions from a size on, in percent, by kind and whether the fallback is on."""
_OUTSIDE_BAR: Final = 3.0
_PEOPLE: Final = ("pedestrian", "person", "cyclist", "child")


@dataclass
class Tally:
    """What was counted in the images of one light.

    Attributes:
        sizes_px: sizes of true regions, by kind.
        found: whether each is covered by 90 %, by kind and whether the fallback is on.
        outside: share of pixels outside of true regions that is covered, a value an image.
    """

    sizes_px: dict[Kind, list[float]] = field(default_factory=lambda: defaultdict(list))
    found: dict[tuple[Kind, bool], list[bool]] = field(default_factory=lambda: defaultdict(list))
    outside: dict[bool, list[float]] = field(default_factory=lambda: defaultdict(list))

    def add(self, image: CrowdImage, detectors: Iterable[Detector], how: Redaction) -> None:
        """Detect in an image, and count."""
        rgb = np.ascontiguousarray(image.bgr[..., ::-1])
        height, width = rgb.shape[:2]
        detected = merged([region for detector in detectors for region in detector(rgb)])
        truth: dict[Kind, Sequence[Target]] = {"face": image.faces, "plate": image.plates}
        for kind, targets in truth.items():
            self.sizes_px[kind] += [
                float(one.size_px[1 if kind == "face" else 0]) for one in targets if one.seen >= LEAST_SEEN[kind]
            ]
        for fallback in (False, True):
            regions = detected + (_strips(image, detected) if fallback else [])
            covered = region_mask(regions, how.grow, width, height)
            for kind, targets in truth.items():
                own = [one for one in regions if one.kind == kind]
                boxes = [box for one in own if (box := grown_box(one, how.grow, width, height)) is not None]
                for target in targets:
                    if target.seen >= LEAST_SEEN[kind]:
                        true = np.clip(target.box_px, 0.0, [width, height, width, height])
                        self.found[kind, fallback].append(covered_share(true.tolist(), boxes) >= COVERED)
            inside = np.zeros((height, width), np.bool_)
            for target in (*image.faces, *image.plates):
                left, top, right, bottom = np.clip(target.box_px, 0.0, [width, height, width, height])
                inside[math.floor(top) : math.ceil(bottom), math.floor(left) : math.ceil(right)] = True
            self.outside[fallback].append(float((covered & ~inside).sum() / (~inside).sum()))

    def rows(self, light: str) -> Iterator[Row]:
        """Yield the share of missed regions by kind and size, with its upper bound, and what is covered beside them."""
        edges_px: dict[Kind, Sequence[float]] = {"face": FACE_EDGES_PX, "plate": PLATE_EDGES_PX}
        for kind, edges in edges_px.items():
            for fallback in (False, True) if kind == "plate" else (False,):
                yield from self._kind_rows(light, kind, edges, fallback)
        for fallback, values in self.outside.items():
            name = f"{light}: outside of true regions covered{', with fallback' if fallback else ''} (%)"
            yield Row(name, f"{len(values)} images", 100.0 * float(np.mean(values)), bar=_OUTSIDE_BAR)

    def _kind_rows(self, light: str, kind: Kind, edges: Sequence[float], fallback: bool) -> Iterator[Row]:
        sizes, found = np.array(self.sizes_px[kind]), np.array(self.found[kind, fallback], np.bool_)
        cells: list[tuple[float, float, float | None]] = [(low, high, None) for low, high in pairwise(edges)]
        cells += [(low, np.inf, bar) for (own, on, low), bar in MISSED_BARS.items() if (own, on) == (kind, fallback)]
        for low, high, bar in cells:
            these = (sizes >= low) & (sizes < high)
            count, missed = int(these.sum()), int((these & ~found).sum())
            if not count:
                continue
            span = f"{low:.0f} px and more" if np.isinf(high) else f"{low:.0f} to {high:.0f} px"
            name = f"{light}, {kind}s{', with fallback' if fallback else ''}, {span}: missed (%)"
            bound = 100.0 * upper_bound(missed, count)
            yield Row(name, f"{count} regions", 100.0 * missed / count, bound, unit="% (95 % bound)", bar=bar)


def _strips(image: CrowdImage, detected: Sequence[Region]) -> list[Region]:
    """The fallback with the exact boxes of the vehicles in the image."""
    vehicles = [user for user in image.road_users if user.body.category not in _PEOPLE]
    if not vehicles:
        return []
    boxes = world_SE3_boxes(vehicles, [user.motion.at(0.0) for user in vehicles])
    sizes = np.array([user.body.size_m for user in vehicles])
    categories = [user.body.category for user in vehicles]
    return plate_strips(image.camera, image.world_SE3_camera.inverse() @ boxes, sizes, categories, detected)


def upper_bound(missed: int, count: int) -> float:
    """The one-sided Clopper-Pearson bound of a share, 95 %."""
    from scipy.stats import beta

    return 1.0 if missed >= count else float(beta.ppf(0.95, missed + 1, count - missed))
