"""An annotator in one file: replace the body of `annotate` by a network of your own.

mirror annotate DATASET --annotator examples/annotator.py:ANNOTATOR
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mirror import Dataset, Frame
from mirror.annotation import Detections


class CarAhead:
    """Finds a car 10 m ahead where the lower half of the front image is dark; see `mirror.annotation.Annotator`."""

    name = "car-ahead"
    version = "1"

    def __init__(self, darkest: float) -> None:
        self.darkest = darkest
        self.fingerprint = f"car-ahead 1, darkest {darkest}"

    def annotate(self, frame: Frame) -> Detections:
        """Find the road users of one frame, in the ego frame."""
        image = frame.images["front_wide"].decode()
        if image[len(image) // 2 :].mean() > self.darkest:
            return Detections.empty(frame.timestamp_ns)
        return Detections.from_arrays(
            frame.timestamp_ns,
            centre_m=np.array([[10.0, 0.0, 0.8]]),
            rotation=np.array([[1.0, 0.0, 0.0, 0.0]]),
            size_m=np.array([[4.5, 1.8, 1.6]]),
            velocity_mps=np.full((1, 3), np.nan),
            category=["car"],
            score=np.array([0.5]),
        )

    def close(self) -> None:
        """Release what the annotator holds: nothing."""


class Installed:
    """See `mirror.annotation.InstalledAnnotator`."""

    settings: Mapping[str, str] = {"darkest": "mean of the lower half of an image below which it shows a car"}

    def open(self, dataset: Dataset, settings: Mapping[str, str], device: str) -> CarAhead:
        """Make the annotator ready."""
        return CarAhead(float(settings.get("darkest", 255.0)))


ANNOTATOR = Installed()
