"""The protocol of a detector: what every built-in and every installed detector of faces or number plates is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol, runtime_checkable

from mirror.arrays import Bool, UInt8
from mirror.privacy.regions import Kind, Region


@runtime_checkable
class Detector(Protocol):
    """A detector of the faces or the number plates of an image.

    Attributes:
        kind: what it finds.
        name: its name; it stands in the log.
        version: version of its code.
        weights_sha256: SHA-256 of its weights in hexadecimal; empty: it has none.
        threshold: the smallest score of a region that it returns.
    """

    kind: Kind
    name: str
    version: str
    weights_sha256: str
    threshold: float

    def __call__(self, image: UInt8) -> list[Region]:
        """Find regions in an upright image (H, W, 3), RGB, without duplicates."""
        ...


@runtime_checkable
class TiledDetector(Detector, Protocol):
    """A detector that can leave out tiles.

    Attributes:
        skipped: (H, W) pixels of the next image that need no search; a tile of such pixels only is left out. None: all
            are searched.
        skipped_tiles: number of tiles that were left out for it.
    """

    skipped: Bool | None
    skipped_tiles: int


@dataclass(frozen=True)
class DetectorOptions:
    """Options that a detector is made with.

    Attributes:
        weights: file of the weights; None: the resolver of weights finds it.
        threshold: the smallest score of a region; None: the detector's own.
    """

    weights: Path | None = None
    threshold: float | None = None


@dataclass(frozen=True)
class DetectorKind:
    """An entry of the registry, and the class of the entry points of the group ``mirror.detectors``.

    Attributes:
        kind: what the detector finds.
        summary: one line for lists.
        make: makes the detector; it raises `WeightsUnavailableError` where the weights are missing or others.
        plate_regions: regions of the world whose number plates it finds, as ISO 3166 codes or names such as ``EU``.
        needs_weights: whether a file must be named, as no source of its weights is known.
    """

    kind: Kind
    summary: str
    make: Callable[[DetectorOptions], Detector]
    plate_regions: frozenset[str] = field(default_factory=frozenset)
    needs_weights: bool = False
