"""Number and places of the initial Gaussians of a street."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hybridworldsim.model.initialization import InitialGeometry, ground_seeds, sky_seeds
from mirror.arrays import Float64
from mirror.geometry.quaternions import matrix_from_quaternion, quaternion_normalise


def level(places: Float64) -> tuple[Float64, Float64]:
    return np.zeros(len(places)), np.tile((0.0, 0.0, 1.0), (len(places), 1))


def crossing(lanes: int) -> InitialGeometry:
    """Two crossing streets with this number of lanes, 3.5 m apart."""
    along = np.arange(-60.0, 60.0, 0.5)
    streets = [np.stack([along, np.full_like(along, 3.5 * lane)], axis=1) for lane in range(lanes)]
    driven = np.concatenate([*streets, *(street[:, ::-1] for street in streets)])
    none = np.empty((0, 3))
    return InitialGeometry(none, none, np.column_stack([driven, np.zeros(len(driven))]), level, 75.0, [])


@pytest.mark.parametrize("lanes", [2, 4])
def test_ground_stays_within_its_limit_and_covers_the_street(lanes: int) -> None:
    free = ground_seeds(crossing(lanes), 0.5, 15.0)
    assert len(free.means) > 12_000
    capped = ground_seeds(crossing(lanes), 0.5, 15.0, 12_000)
    assert 10_000 < len(capped.means) <= 12_000
    # The spacing and the size grow by the same factor.
    grow_anchors = capped.scales[:, 0].min() / free.scales[:, 0].min()
    assert grow_anchors == pytest.approx(np.sqrt(len(free.means) / len(capped.means)), rel=0.05)
    for low in (-60.0, -30.0, 0.0, 30.0):
        inside = (capped.means[:, 0] >= low) & (capped.means[:, 0] < low + 30.0)
        before = (free.means[:, 0] >= low) & (free.means[:, 0] < low + 30.0)
        assert float(inside.sum() / before.sum()) == pytest.approx(len(capped.means) / len(free.means), rel=0.1)


def test_sky_is_a_hemisphere_of_equal_areas_facing_inwards() -> None:
    count, block = 600, crossing(1)
    dome = sky_seeds(block, count, 4.0, 10)
    means = dome.means.numpy().astype(np.float64)
    np.testing.assert_allclose(np.linalg.norm(means, axis=1), 4.0 * block.radius_m, rtol=1e-6)
    directions = means / np.linalg.norm(means, axis=1, keepdims=True)
    assert directions[:, 2].min() > -0.05
    # Slices of equal height and sectors of equal angle have equal areas.
    heights, _ = np.histogram(directions[:, 2], bins=6, range=(-0.05, 1.0))
    sectors, _ = np.histogram(np.arctan2(directions[:, 1], directions[:, 0]), bins=8, range=(-np.pi, np.pi))
    assert np.abs(heights - count / 6).max() <= 1 and np.abs(sectors - count / 8).max() <= 4
    # No gaps: each point of the dome has a Gaussian within two of its standard deviations.
    rng = np.random.default_rng(0)
    asked = rng.normal(size=(4000, 3))
    asked[:, 2] = np.abs(asked[:, 2])
    asked /= np.linalg.norm(asked, axis=1, keepdims=True)
    apart_m = 300.0 * np.sqrt(np.square(asked[:, None] - directions).sum(-1).min(1))
    assert apart_m.max() < 2.0 * float(dome.scales[0, 0])
    # The thin axis is the line of sight.
    thin = matrix_from_quaternion(quaternion_normalise(dome.quats.numpy().astype(np.float64)))[:, :, 2]
    np.testing.assert_allclose(np.abs((thin * directions).sum(1)), 1.0, atol=1e-6)


def test_points_beyond_the_dome_are_moved_inside_along_their_ray() -> None:
    far = np.array([[100.0, 0.0, 20.0], [0.0, 500.0, 0.0], [-900.0, 900.0, 90.0]])
    street = replace(crossing(1), far_m=far)
    seeds = sky_seeds(street, 200, 4.0, 10).means[200:].numpy().astype(np.float64)
    seeds = seeds[np.argsort(np.linalg.norm(seeds, axis=1))]
    np.testing.assert_allclose(seeds[0], far[0], rtol=1e-6)
    np.testing.assert_allclose(np.sort(np.linalg.norm(seeds[1:], axis=1)), [270.0, 270.0], rtol=1e-6)
    ways = {tuple(np.round(one / np.linalg.norm(one), 5)) for one in seeds}
    assert ways == {tuple(np.round(one / np.linalg.norm(one), 5)) for one in far}


def test_thinning_keeps_points_within_the_limit() -> None:
    free, capped = (ground_seeds(crossing(1), 1.0, 15.0, most) for most in (None, 20_000))
    assert len(free.means) == len(capped.means) < 20_000
