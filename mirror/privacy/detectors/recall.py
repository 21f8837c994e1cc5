"""The recall of a detector on synthetic plates of each region, and the regions that it therefore covers."""

from __future__ import annotations

from typing import Final

from mirror.schema.documents import Document

ANY: Final = "ANY"
"""The region of datasets whose plates come from anywhere: a release of them needs a review by persons."""
LEAST_PLATES: Final = 40
NEAR: Final = 0.95
"""Least share of the plates from 192 px that are covered."""
ALL: Final = 0.90
"""Least share of the plates from 64 px that are covered."""


class RegionRecall(Document):
    """Counts of synthetic plates with the shapes of a region that are covered to 90 % of their area.

    Attributes:
        plates: number of plates from 64 px.
        covered: number of these that are covered.
        near_plates: number of plates from 192 px.
        near_covered: number of these that are covered.
    """

    plates: int
    covered: int
    near_plates: int
    near_covered: int

    @property
    def is_enough(self) -> bool:
        """Return whether there are enough plates, and the shares reach `ALL` and `NEAR`."""
        counted = self.plates >= LEAST_PLATES and self.near_plates > 0
        return counted and self.covered >= ALL * self.plates and self.near_covered >= NEAR * self.near_plates


class SyntheticRecall(Document):
    """The published recall of some weights.

    Attributes:
        weights_sha256: SHA-256 of the weights, in hexadecimal.
        images: number of images of each region.
        regions: recall by region, as ISO 3166 codes or ``EU``.
    """

    weights_sha256: str
    images: int
    regions: dict[str, RegionRecall]


def covered_regions(recall: SyntheticRecall, weights_sha256: str) -> frozenset[str]:
    """Return the regions with enough recall, and `ANY` if all regions have enough.

    The tuple is empty if the recall is that of other weights.
    """
    if recall.weights_sha256 != weights_sha256:
        return frozenset()
    enough = {region for region, one in recall.regions.items() if one.is_enough}
    return frozenset(enough | {ANY} if enough and enough == set(recall.regions) else enough)
