"""The fallback with boxes that are wrong by a known amount, as those of an annotation are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

import numpy as np

from benchmarks.privacy.outcomes import Outcome, Vehicle
from benchmarks.privacy.recall import Tally
from benchmarks.report import Row
from mirror.geometry.poses import Poses
from mirror.privacy.operators import Redaction
from mirror.privacy.propagation.vehicles import StripOptions

_ERRORS_M: Final = (0.0, 0.1, 0.2, 0.3)
_DEG_PER_M: Final = 10.0
_SEED: Final = 7


def box_error_rows(street: Sequence[Outcome], near: Sequence[Outcome], how: Redaction) -> Iterator[Row]:
    """Yield the missed and the covered area of the fallback, by the boxes' error and whether it is stated."""
    for error_m in _ERRORS_M:
        for stated_m in sorted({0.0, error_m}):
            rng = np.random.default_rng(_SEED)
            tally = Tally(StripOptions(box_error_m=stated_m))
            for outcome in street:
                tally.add(disturb(outcome, error_m, rng), how)
            for outcome in near:
                tally.add(disturb(outcome, error_m, rng), how, plates_only=True)
            case = f"error {error_m:.1f} m, {_DEG_PER_M * error_m:.0f} degrees; stated {stated_m:.1f} m"
            yield from tally.fallback_rows(case)


def disturb(outcome: Outcome, error_m: float, rng: np.random.Generator) -> Outcome:
    """Move and turn the boxes of an image by normal errors: a third of it upwards, and 10 degrees for each metre."""
    vehicles = []
    for vehicle in outcome.vehicles:
        box = Poses(*(np.array([part]) for part in (vehicle.camera_SE3_box[:4], vehicle.camera_SE3_box[4:])))
        half = 0.5 * np.radians(rng.normal(0.0, _DEG_PER_M * error_m))
        moved = rng.normal(0.0, error_m, 3) * (1.0, 1.0, 1.0 / 3.0)
        box @= Poses(np.array([[np.cos(half), 0.0, 0.0, np.sin(half)]]), moved[None])
        row = np.concatenate([box.rotation[0], box.translation[0]])
        vehicles.append(Vehicle(camera_SE3_box=tuple(row.tolist()), size_m=vehicle.size_m, category=vehicle.category))
    return outcome.model_copy(update={"vehicles": tuple(vehicles)})
