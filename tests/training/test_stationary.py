"""Images of a stationary vehicle."""

from __future__ import annotations

import numpy as np
import pytest

from hybridworldsim.stationary import select_moving


def along(*metres: float) -> list[np.ndarray]:
    return [np.array([one, 0.0, 0.0]) for one in metres]


def test_creeping_vehicle_keeps_some_images() -> None:
    places = along(*np.arange(11) * 0.125)
    assert select_moving((("a", place) for place in places), 0.25) == [0, 2, 4, 6, 8, 10]


def test_cameras_are_thinned_separately_and_keep_their_first_image() -> None:
    taken = [(camera, place) for place in along(5.0, 5.1, 5.2, 5.6) for camera in ("front", "rear")]
    assert select_moving(taken, 0.25) == [0, 1, 6, 7]


@pytest.mark.parametrize("stationary_m, kept", [(0.0, [0, 1, 2]), (1e9, [0])])
def test_threshold_of_zero_keeps_all_and_infinite_keeps_one(stationary_m: float, kept: list[int]) -> None:
    assert select_moving((("a", place) for place in along(1.0, 1.0, 2.0)), stationary_m) == kept
