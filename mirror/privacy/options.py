"""The options of a de-identification, and the hash that identifies its configuration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

from mirror.executors.choice import ExecutorChoice
from mirror.privacy.detectors.registry import DEFAULT, DetectorChoice
from mirror.privacy.log import DetectorRecord
from mirror.privacy.operators import Redaction
from mirror.privacy.propagation.vehicles import StripOptions
from mirror.schema.hashing import hash_document
from mirror.version import __version__


@dataclass(frozen=True)
class SkipRules:
    """Rules for places where no detector searches; each skipped tile and image is counted in the log.

    Attributes:
        ego: tiles that show the recording vehicle only, by the rig's static mask.
        sky: tiles that show the sky only, by a layer of masks.
        without_boxes: images in which no box of a person or vehicle is visible. It trusts the annotation.
    """

    ego: bool = True
    sky: bool = True
    without_boxes: bool = False


@dataclass(frozen=True)
class Propagation:
    """The steps that add regions to the detectors' regions.

    Attributes:
        tracks: along the images of a camera, forwards and backwards.
        cameras: to the other cameras of an instant.
        vehicles: to the front and rear of vehicles' 3D boxes.
        repeats: how often redacted images are searched again, until nothing more is found.
        strips: where plates are expected at vehicles.
    """

    tracks: bool = True
    cameras: bool = True
    vehicles: bool = True
    repeats: int = 4
    strips: StripOptions = field(default_factory=StripOptions)


@dataclass(frozen=True)
class DeidentifyOptions:
    """Options of the de-identification of a dataset.

    Attributes:
        detectors: the detectors; several of a kind are joined.
        plate_region: region of the number plates, such as ``CN``; it must be one that a plate detector covers.
        version: version of the layers that are written.
        redaction: operators and margins.
        skip: where no detector searches.
        propagation: which regions are added.
        workers: number of processes.
        timeout_s: longest time that the detectors may take for one image.
        withhold_failed: complete traversals without the images that failed; their rows stay raw, and a release leaves
            them out.
        shards: write the redacted images of a traversal side by side into tar archives; False: a file each; None: as
            its recorded images are. A layer that is complete stays as it is.
        executor: where detectors search; None: in processes of this machine, side by side in one traversal. On a
            cluster each worker takes a traversal at a time, and searches it in one process beside it.
    """

    detectors: Sequence[DetectorChoice] = tuple(DetectorChoice(name) for name in DEFAULT)
    plate_region: str | None = None
    version: str = "1"
    redaction: Redaction = field(default_factory=Redaction)
    skip: SkipRules = field(default_factory=SkipRules)
    propagation: Propagation = field(default_factory=Propagation)
    workers: int = 1
    timeout_s: float = 120.0
    withhold_failed: bool = False
    shards: bool | None = None
    executor: ExecutorChoice | None = None


def detection_hash(detectors: Sequence[DetectorRecord], options: DeidentifyOptions) -> str:
    """Hash the settings that decide which regions the detectors find."""
    return hash_document({"detectors": [one.model_dump() for one in detectors], "skip": asdict(options.skip)})


def configuration_hash(detectors: Sequence[DetectorRecord], options: DeidentifyOptions) -> str:
    """Hash the settings that decide the bytes of the layers and their log.

    The number of workers has no effect.
    """
    return hash_document(
        {
            "detection": detection_hash(detectors, options),
            "redaction": asdict(options.redaction),
            "propagation": asdict(options.propagation),
            "plate_region": options.plate_region,
            "tool": __version__,
        }
    )
