"""True boxes and predictions around them."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from mirror.arrays import Float64
from mirror.metrics.detection import DETECTION_CVPR_2019, DetectionBoxes

CLASSES = list(DETECTION_CVPR_2019.class_range)
ATTRIBUTES = np.array(["", "vehicle.moving", "vehicle.parked"])


def boxes(
    sample: npt.ArrayLike,
    category: npt.ArrayLike,
    centre: npt.ArrayLike,
    *,
    lwh: Float64 | None = None,
    yaw: npt.ArrayLike | None = None,
    velocity: npt.ArrayLike | None = None,
    attribute: npt.ArrayLike | None = None,
    score: npt.ArrayLike | None = None,
) -> DetectionBoxes:
    """Boxes of the size of a car; what is not given is zero, or empty."""
    count = len(np.asarray(sample))
    return DetectionBoxes(
        np.asarray(sample),
        np.asarray(category),
        np.asarray(centre, dtype=float),
        np.tile([4.0, 2.0, 1.5], (count, 1)) if lwh is None else lwh,
        np.zeros(count) if yaw is None else np.asarray(yaw, dtype=float),
        np.zeros((count, 2)) if velocity is None else np.asarray(velocity, dtype=float),
        np.full(count, "") if attribute is None else np.asarray(attribute),
        np.zeros(count) if score is None else np.asarray(score, dtype=float),
    )


def random_scene(
    samples: int, per_sample: int, predicted: int, seed: int = 0, classes: list[str] = CLASSES, ties: bool = True
) -> tuple[DetectionBoxes, DetectionBoxes]:
    """True boxes, and predictions scattered around them, with ties of scores and what is not known."""
    generator = np.random.default_rng(seed)

    def some(count: int, score: Float64) -> dict[str, Any]:
        velocity = generator.normal(size=(count, 2))
        velocity[generator.random(count) < 0.1] = np.nan
        return {
            "lwh": np.exp(generator.normal(size=(count, 3)) * 0.3 + 0.7),
            "yaw": generator.uniform(-np.pi, np.pi, count),
            "velocity": velocity,
            "attribute": generator.choice(ATTRIBUTES, count),
            "score": score,
        }

    count = samples * per_sample
    sample = np.repeat([f"s{number}" for number in range(samples)], per_sample)
    centre = generator.uniform(-20, 20, (count, 3))
    category = generator.choice(classes, count)
    truth = boxes(sample, category, centre, **some(count, np.zeros(count)))
    of = generator.integers(0, per_sample, (samples, predicted)) + per_sample * np.arange(samples)[:, None]
    of = of.ravel()
    score = generator.random(len(of))
    found = centre[of] + generator.normal(size=(len(of), 3)) * generator.choice([0.1, 0.6, 3.0], (len(of), 1))
    if ties:
        score = np.round(score, 2)
        # Equally far from one box on either side.
        found = np.round(found, 1)
    kind = np.where(generator.random(len(of)) < 0.9, category[of], generator.choice(classes, len(of)))
    return truth, boxes(sample[of], kind, found, **some(len(of), score))
