"""Images of a standing vehicle."""

from __future__ import annotations

import numpy as np
import pytest

from hybridworldsim.stationary import select_moving


def along(*metres: float) -> list[np.ndarray]:
    return [np.array([one, 0.0, 0.0]) for one in metres]


def test_a_creeping_vehicle_is_seen_once_in_a_while() -> None:
    places = along(*np.arange(11) * 0.125)
    assert select_moving((("a", place) for place in places), 0.25) == [0, 2, 4, 6, 8, 10]


def test_each_camera_has_its_own_last_picture_and_keeps_its_first() -> None:
    taken = [(camera, place) for place in along(5.0, 5.1, 5.2, 5.6) for camera in ("front", "rear")]
    assert select_moving(taken, 0.25) == [0, 1, 6, 7]


@pytest.mark.parametrize("stationary_m, kept", [(0.0, [0, 1, 2]), (1e9, [0])])
def test_none_or_all_stand(stationary_m: float, kept: list[int]) -> None:
    assert select_moving((("a", place) for place in along(1.0, 1.0, 2.0)), stationary_m) == kept
