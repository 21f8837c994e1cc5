"""Points on lanes and on a line: edges belong to a lane, and a line that comes back is followed."""

from __future__ import annotations

import numpy as np
import pytest

from mirror.metrics.safety.lane_kernels import project_on_lanes, project_on_line


def with_lengths(points: list[tuple[float, float]]) -> np.ndarray:
    """A line (K, 3): its points and the length up to each."""
    line = np.array(points)
    steps = np.hypot(*np.diff(line, axis=0).T)
    return np.column_stack([line, np.concatenate([[0.0], np.cumsum(steps)])])


@pytest.mark.parametrize("side", [-2.0, 2.0])
@pytest.mark.parametrize("turned", [False, True])
def test_a_point_on_the_edge_of_a_lane_is_in_it(side: float, turned: bool) -> None:
    ends = [(0.0, 0.0), (8.0, 0.0)]
    points = np.array([[4.0, side], [0.0, side], [8.0, side], [4.0, np.nextafter(side, 2.0 * side)]])
    if turned:
        ends, points = [(y, x) for x, y in ends], points[:, ::-1].copy()
    offset, along, _ = project_on_lanes(points, with_lengths(ends), np.full(2, 2.0), np.array([0, 2]))
    assert along[:, 0].tolist()[:3] == [4.0, 0.0, 8.0] and np.isnan(along[3, 0])
    # Positive to the left.
    np.testing.assert_array_equal(offset[:3, 0], [-side if turned else side] * 3)


def test_a_line_that_comes_back_is_followed() -> None:
    """The second point is nearer to the way there, which is more than 1 m and twice its step behind on the line."""
    line = with_lengths([(0.0, 0.0), (0.5, 0.0), (1.0, 0.0), (1.0, 0.3), (0.0, 0.3)])
    along, offset = project_on_line(np.array([[0.1, 0.29], [0.1, 0.1]]), line)
    assert along == pytest.approx([2.2, 2.2], abs=1e-12)
    assert offset == pytest.approx([0.01, 0.2], abs=1e-12)
    # Alone it has no last foot to follow.
    along, offset = project_on_line(np.array([[0.1, 0.1]]), line)
    assert along == pytest.approx([0.1], abs=1e-12) and offset == pytest.approx([0.1], abs=1e-12)


def test_the_way_ahead_is_followed_as_far() -> None:
    line = with_lengths([(0.0, 0.3), (1.0, 0.3), (1.0, 0.0), (0.5, 0.0), (0.0, 0.0)])
    along, _ = project_on_line(np.array([[0.1, 0.29], [0.1, 0.1]]), line)
    assert along == pytest.approx([0.1, 0.1], abs=1e-12)
