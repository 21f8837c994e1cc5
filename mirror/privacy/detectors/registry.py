"""The installed detectors, and the choice of some of them: entry points of the group ``mirror.detectors``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from mirror.errors import UsageError
from mirror.plugins import PluginKind
from mirror.privacy.detectors.protocol import Detector, DetectorKind, DetectorOptions
from mirror.privacy.log import DetectorRecord
from mirror.privacy.regions import KINDS

DETECTORS: Final = PluginKind("detector", "mirror.detectors", "--detector", "privacy", takes_files=False)
DEFAULT: Final = ("centerface", "world_plates")
DEFAULT_BY_REGION: Final = {"CN": ("centerface", "world_plates", "clp_det")}
"""Defaults for the plates of some regions: one more detector that was trained on real plates of theirs."""
_FORM: Final = re.compile(r"(?P<name>[\w\-]+)(=(?P<file>[^@]+))?(@(?P<regions>[\w,\-]+))?")


@dataclass(frozen=True)
class DetectorChoice:
    """One detector as chosen by a user.

    Attributes:
        name: name of its entry point.
        weights: file of its weights; None: the resolver of weights finds it.
        plate_regions: regions of the world whose plates it finds, as the user states; None: the detector's own.
        threshold: smallest score of a region; None: the detector's own.
    """

    name: str
    weights: Path | None = None
    plate_regions: frozenset[str] | None = None
    threshold: float | None = None

    def make(self) -> Detector:
        """Make the detector.

        Raises:
            UsageError: no such detector is installed.
            WeightsUnavailableError: its weights are missing or not the published ones.
            DetectorError: a package is missing, or the weights cannot be read.
        """
        return find_detector(self.name).make(DetectorOptions(self.weights, self.threshold))


def default_choices(plate_region: str | None) -> tuple[DetectorChoice, ...]:
    """Return the detectors that are used for the number plates of a region if none are chosen."""
    names = DEFAULT if plate_region is None else DEFAULT_BY_REGION.get(plate_region.upper(), DEFAULT)
    return tuple(DetectorChoice(name) for name in names)


def parse_choice(text: str) -> DetectorChoice:
    """Parse ``NAME``, ``NAME=FILE``, ``NAME@REGIONS`` or ``NAME=FILE@REGIONS``; commas separate regions.

    Raises:
        UsageError: the text has another form, or no such detector is installed.
    """
    match = _FORM.fullmatch(text)
    if match is None:
        raise UsageError(f"{text!r}", place="--detector", expected="NAME, NAME=FILE or NAME=FILE@REGION,REGION")
    find_detector(match["name"])
    regions = match["regions"]
    stated = None if regions is None else frozenset(part.upper() for part in regions.split(",") if part)
    return DetectorChoice(match["name"], None if match["file"] is None else Path(match["file"]), stated)


def installed_detectors() -> dict[str, DetectorKind]:
    """Load all installed detectors, by name.

    Raises:
        UsageError: one cannot be loaded.
    """
    return DETECTORS.load_all()


def find_detector(name: str) -> DetectorKind:
    """Load a detector.

    Raises:
        UsageError: it is not installed, or cannot be loaded.
    """
    found: DetectorKind = DETECTORS.load(name)
    return found


def require_coverage(choices: Sequence[DetectorChoice], plate_region: str | None) -> str:
    """Require a detector of each kind, and one that finds the plates of the dataset's region.

    Args:
        choices: the chosen detectors.
        plate_region: region of the plates, such as ``CN`` or ``EU``.

    Returns:
        The region in upper case, as logs and hashes have it.

    Raises:
        UsageError: a kind has no detector, the region is not stated, or no plate detector covers it.
    """
    for kind in KINDS:
        if not any(find_detector(choice.name).kind == kind for choice in choices):
            raise UsageError(
                f"no {kind} detector: nothing was written", place="--detector",
                expected=f"a detector of {kind}s: {', '.join(_of_kind(kind))}",
                remedy=f"name one: --detector {_of_kind(kind)[0]}",
            )  # fmt: skip
    plates = [choice for choice in choices if find_detector(choice.name).kind == "plate"]
    covered = {choice.name: _regions(choice) for choice in plates}
    listed = "; ".join(f"{name}: {', '.join(sorted(own)) or 'not stated'}" for name, own in covered.items())
    if plate_region is None:
        raise UsageError(
            "the region of the number plates is not stated: nothing was written", place="--plate-region",
            expected=f"a region that a chosen detector covers ({listed})", remedy="state it: --plate-region CN",
        )  # fmt: skip
    region = plate_region.upper()
    if not any(region in own for own in covered.values()):
        raise UsageError(
            f"no chosen detector covers number plates of {plate_region}: nothing was written", place="--plate-region",
            expected=f"a detector of these plates ({listed})",
            remedy="name one by path, and state what it covers: --detector yolo_plates=FILE@"
            f"{region}; a statement for a built-in detector (world_plates@{region}) is yours",
        )  # fmt: skip
    return region


def describe(detector: Detector) -> DetectorRecord:
    """Return the line of a detector in the log."""
    return DetectorRecord(
        kind=detector.kind, name=detector.name, version=detector.version, weights_sha256=detector.weights_sha256,
        threshold=detector.threshold,
    )  # fmt: skip


def _regions(choice: DetectorChoice) -> frozenset[str]:
    return find_detector(choice.name).plate_regions if choice.plate_regions is None else choice.plate_regions


def _of_kind(kind: str) -> list[str]:
    return [name for name, known in installed_detectors().items() if known.kind == kind]
