"""A parked car whose fixes alternate about the circle: equal excursions are split in nearly linear time."""

from __future__ import annotations

import time

import numpy as np
import pytest

from mirror.ingest.clean import clean
from mirror.ingest.trigger import Pass, RoiTrigger
from mirror.recordings.protocol import Track
from mirror.schema.documents import CleaningOptions, Roi, TriggerOptions

ROI = Roi(scene_id="here", frame="yard", x_m=0.0, y_m=0.0, radius_m=100.0)


def alternating(fixes: int, step_m: float = 0.6) -> tuple[list[Pass], float]:
    """The passes of a car that stands on the circle for a fix a second, and the processor time that they take."""
    stamps = 1_700_000_000_000_000_000 + np.arange(fixes) * 1_000_000_000
    x = 100.0 + step_m * (np.arange(fixes) % 2 - 0.5)
    track, _ = clean(Track(stamps, x_m=x, y_m=np.zeros(fixes)), CleaningOptions())
    trigger = RoiTrigger([ROI], TriggerOptions(), CleaningOptions())
    began = time.process_time()
    passes = trigger.passes(track, frame="yard")
    return passes, time.process_time() - began


@pytest.mark.parametrize("step_m", [0.6, 0.3])
def test_equal_excursions_take_a_time_that_grows_with_their_number(step_m: float) -> None:
    alternating(100, step_m)
    for _ in range(3):
        few, short_s = alternating(4_000, step_m)
        many, long_s = alternating(32_000, step_m)
        # Every visit becomes a part of its own: 8 times the visits; the square would be 64 times the work.
        assert len(many) == 8 * len(few) == 16_000
        assert all(one.split and one.visits == 1 for one in many)
        if long_s < 20.0 * short_s:
            return
    pytest.fail(f"{long_s:.2f} s for 32,000 fixes, {short_s:.2f} s for 4,000")
