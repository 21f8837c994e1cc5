"""What a detection benchmark in the manner of nuScenes is declared by: classes, ranges, thresholds, weights."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Final

from mirror.errors import UsageError

TP_ERRORS: Final = ("trans_err", "scale_err", "orient_err", "vel_err", "attr_err")


@dataclass(frozen=True)
class DetectionConfig:
    """Settings, under the names that the nuScenes development kit's configuration files have.

    Attributes:
        class_range: the classes, and up to which distance from the ego vehicle, in metres, each is judged.
        dist_ths: distances of centres, in metres, below which boxes match; AP is the mean over them.
        dist_th_tp: the one of them at which errors of true positives are taken.
        min_recall: recall up to which precision and errors are left out.
        min_precision: precision that counts as none.
        max_boxes_per_sample: how many predictions a sample may have.
        mean_ap_weight: weight of mAP in the nuScenes detection score, that of an error's score being 1.
        undefined_errors: errors that a class does not have.
        half_turn_classes: classes whose heading is known up to half a turn.

    Raises:
        UsageError: a value is out of its range, or a class or an error is not known.
    """

    class_range: Mapping[str, float]
    dist_ths: tuple[float, ...]
    dist_th_tp: float
    min_recall: float
    min_precision: float
    max_boxes_per_sample: int
    mean_ap_weight: float
    undefined_errors: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    half_turn_classes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.class_range:
            raise UsageError("no classes", place="class_range", expected="at least one")
        if not self.dist_ths or not all(distance > 0.0 for distance in self.dist_ths):
            raise UsageError(f"{self.dist_ths}", place="dist_ths", expected="distances above 0")
        if self.dist_th_tp not in self.dist_ths:
            raise UsageError(f"{self.dist_th_tp}", place="dist_th_tp", expected=f"one of dist_ths, {self.dist_ths}")
        if not 0.0 <= self.min_recall < 1.0:
            raise UsageError(f"{self.min_recall}", place="min_recall", expected="a share of at least 0 and below 1")
        if not 0.0 <= self.min_precision < 1.0:
            raise UsageError(f"{self.min_precision}", place="min_precision", expected="a share of at least 0, below 1")
        unknown = {*self.undefined_errors, *self.half_turn_classes} - {*self.class_range}
        if unknown:
            raise UsageError(f"settings of {sorted(unknown)}", expected=f"classes of {list(self.class_range)}")
        errors = {error for some in self.undefined_errors.values() for error in some} - {*TP_ERRORS}
        if errors:
            raise UsageError(f"{sorted(errors)}", place="undefined_errors", expected=" | ".join(TP_ERRORS))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> DetectionConfig:
        """Make settings from the content of a configuration file, such as one of nuScenes' own.

        Raises:
            UsageError: a setting is missing or unknown, the distance is another one, or a value is out of range.
        """
        given = dict(values)
        distance = given.pop("dist_fcn", "center_distance")
        if distance != "center_distance":
            raise UsageError(f"distance {distance!r}", place="dist_fcn", expected="center_distance")
        names = {part.name for part in fields(cls)}
        missing = names - {"undefined_errors", "half_turn_classes"} - given.keys()
        if missing or given.keys() - names:
            raise UsageError(
                f"missing {sorted(missing)}, unknown {sorted(given.keys() - names)}",
                place="detection configuration",
                expected=", ".join(sorted(names)),
            )
        for name in ("dist_ths", "half_turn_classes"):
            given[name] = tuple(given.get(name, ()))
        undefined = given.get("undefined_errors", {})
        given["undefined_errors"] = {name: tuple(errors) for name, errors in undefined.items()}
        return cls(**given)

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as JSON values."""
        return {
            "class_range": dict(self.class_range),
            "dist_fcn": "center_distance",
            "dist_ths": list(self.dist_ths),
            "dist_th_tp": self.dist_th_tp,
            "min_recall": self.min_recall,
            "min_precision": self.min_precision,
            "max_boxes_per_sample": self.max_boxes_per_sample,
            "mean_ap_weight": self.mean_ap_weight,
            "undefined_errors": {name: list(errors) for name, errors in self.undefined_errors.items()},
            "half_turn_classes": list(self.half_turn_classes),
        }


# https://www.nuscenes.org/object-detection; the last two settings are in the development kit's code.
DETECTION_CVPR_2019: Final = DetectionConfig(
    class_range={
        "car": 50,
        "truck": 50,
        "bus": 50,
        "trailer": 50,
        "construction_vehicle": 50,
        "pedestrian": 40,
        "motorcycle": 40,
        "bicycle": 40,
        "traffic_cone": 30,
        "barrier": 30,
    },
    dist_ths=(0.5, 1.0, 2.0, 4.0),
    dist_th_tp=2.0,
    min_recall=0.1,
    min_precision=0.1,
    max_boxes_per_sample=500,
    mean_ap_weight=5,
    undefined_errors={"traffic_cone": ("orient_err", "vel_err", "attr_err"), "barrier": ("vel_err", "attr_err")},
    half_turn_classes=("barrier",),
)
