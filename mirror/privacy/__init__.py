"""De-identification: detectors, operators, and the layers and log of a de-identified dataset; releases of it."""

from __future__ import annotations

from mirror.lazy import lazy_names

TYPE_CHECKING = False
if TYPE_CHECKING:
    from mirror.privacy.detectors.protocol import Detector as Detector
    from mirror.privacy.detectors.protocol import DetectorKind as DetectorKind
    from mirror.privacy.detectors.protocol import DetectorOptions as DetectorOptions
    from mirror.privacy.detectors.registry import DetectorChoice as DetectorChoice
    from mirror.privacy.detectors.registry import parse_choice as parse_choice
    from mirror.privacy.operators import Redaction as Redaction
    from mirror.privacy.options import DeidentifyOptions as DeidentifyOptions
    from mirror.privacy.options import Propagation as Propagation
    from mirror.privacy.options import SkipRules as SkipRules
    from mirror.privacy.propagation.vehicles import StripOptions as StripOptions
    from mirror.privacy.regions import Region as Region
    from mirror.privacy.run import DeidentifyReport as DeidentifyReport
    from mirror.privacy.run import deidentify as deidentify

_NAMES = {
    "Detector": "mirror.privacy.detectors.protocol",
    "DetectorKind": "mirror.privacy.detectors.protocol",
    "DetectorOptions": "mirror.privacy.detectors.protocol",
    "DetectorChoice": "mirror.privacy.detectors.registry",
    "parse_choice": "mirror.privacy.detectors.registry",
    "Redaction": "mirror.privacy.operators",
    "DeidentifyOptions": "mirror.privacy.options",
    "Propagation": "mirror.privacy.options",
    "SkipRules": "mirror.privacy.options",
    "StripOptions": "mirror.privacy.propagation.vehicles",
    "Region": "mirror.privacy.regions",
    "DeidentifyReport": "mirror.privacy.run",
    "deidentify": "mirror.privacy.run",
}

__all__ = list(_NAMES)

__getattr__, __dir__ = lazy_names(__name__, _NAMES)
