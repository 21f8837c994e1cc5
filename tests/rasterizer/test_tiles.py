"""Pairs of tile and Gaussian, against all pixels of all Gaussians."""

import numpy as np
import pytest

from hybridworldsim.rasterizer.cpu.blending.splats import pack_splats
from hybridworldsim.rasterizer.cpu.blending.tiles import assign_tiles

WIDTH, HEIGHT, TILES_X, TILES_Y = 117, 70, 8, 5


def ellipses(count, longest, seed=0):
    random = np.random.default_rng(seed)
    means = random.uniform([-20.0, -20.0], [WIDTH + 20.0, HEIGHT + 20.0], (count, 2))
    along, across = random.uniform(0.3, longest, count) ** 2 + 0.3, random.uniform(0.3, 2.0, count) ** 2 + 0.3
    turn = random.uniform(0.0, np.pi, count)
    cosine, sine = np.cos(turn), np.sin(turn)
    xx, yy = cosine**2 * along + sine**2 * across, sine**2 * along + cosine**2 * across
    xy = cosine * sine * (along - across)
    determinant = xx * yy - xy * xy
    f11 = np.sqrt(yy / determinant)
    factors = np.stack([f11, -xy / determinant / f11, 1.0 / np.sqrt(xx * 0.0 + yy)], axis=1)
    factors[:, 2] = 1.0 / np.sqrt(yy)
    return means, factors, random.uniform(0.0, 1.0, count), random.uniform(1.0, 9.0, count)


def reach(means, factors, opacities):
    """(N, tiles) the greatest alpha among each tile's pixels."""
    y, x = np.mgrid[: TILES_Y * 16, : TILES_X * 16] + 0.5
    dx, dy = x - means[:, 0, None, None], y - means[:, 1, None, None]
    u = factors[:, 0, None, None] * dx + factors[:, 1, None, None] * dy
    v = factors[:, 2, None, None] * dy
    alpha = opacities[:, None, None] * np.exp(-0.5 * (u * u + v * v))
    return alpha.reshape(len(means), TILES_Y, 16, TILES_X, 16).max(axis=(2, 4)).reshape(len(means), -1)


@pytest.mark.parametrize("longest", [0.5, 4.0, 30.0, 300.0])
def test_each_tile_has_the_gaussians_that_reach_it_in_depth_order(longest):
    means, factors, opacities, depths = ellipses(400, longest)
    order = np.argsort(depths).astype(np.int32)
    single = means.astype(np.float32)
    splats = pack_splats(
        single, (means - single).astype(np.float32), factors, opacities.astype(np.float32),
        np.zeros((400, 3), np.float32), np.full((400, 2), 1 << 20, np.int32), TILES_X, TILES_Y,
    )  # fmt: skip
    tiles = assign_tiles(splats, order, TILES_X, np.ones(TILES_X * TILES_Y, np.bool_))
    greatest = reach(means, factors, opacities)
    rank = np.argsort(order)
    listed = np.zeros_like(greatest, dtype=bool)
    for tile in range(TILES_X * TILES_Y):
        ids = tiles.ids[tiles.tile_starts[tile] : tiles.tile_starts[tile + 1]]
        assert (np.diff(rank[ids]) > 0).all()
        listed[ids, tile] = True
    assert listed[greatest >= (1.0 + 1e-5) / 255.0].all()
    # the ellipse is tested along the rows' edges, the alphas at pixels: few tiles are listed that no pixel needs
    assert (listed & (greatest < 1.0 / 255.0)).sum() <= 0.1 * listed.sum()


@pytest.mark.parametrize("longest", [4.0, 30.0, 300.0])
def test_no_tile_is_listed_that_the_ellipse_misses(longest):
    """A row of tiles lists those between the leftmost and the rightmost place of the ellipse on the row's pixels."""
    means, factors, opacities, depths = ellipses(400, longest, seed=2)
    order = np.argsort(depths).astype(np.int32)
    single = means.astype(np.float32)
    splats = pack_splats(
        single, (means - single).astype(np.float32), factors, opacities.astype(np.float32),
        np.zeros((400, 3), np.float32), np.full((400, 2), 1 << 20, np.int32), TILES_X, TILES_Y,
    )  # fmt: skip
    tiles = assign_tiles(splats, order, TILES_X, np.ones(TILES_X * TILES_Y, np.bool_))
    listed = np.zeros((400, TILES_Y, TILES_X), dtype=bool)
    for tile in range(TILES_X * TILES_Y):
        ids = tiles.ids[tiles.tile_starts[tile] : tiles.tile_starts[tile + 1]]
        listed[ids, tile // TILES_X, tile % TILES_X] = True
    slack_px = 0.05
    level = 2.0 * np.log(np.maximum(opacities * 255.0, 1.0))[:, None]
    f11, f12, f22 = (column[:, None] for column in factors.T)
    for row in range(TILES_Y):
        dy = np.linspace(16 * row + 0.5 - slack_px, 16 * row + 15.5 + slack_px, 1001) - means[:, 1:]
        rest = level - (f22 * dy) ** 2
        half = np.sqrt(np.maximum(rest, 0.0)) / f11
        left = np.where(rest >= 0.0, means[:, :1] - f12 / f11 * dy - half, np.inf).min(axis=1)
        right = np.where(rest >= 0.0, means[:, :1] - f12 / f11 * dy + half, -np.inf).max(axis=1)
        first_px, last_px = 16 * np.arange(TILES_X) + 0.5, 16 * np.arange(TILES_X) + 15.5
        reached = (left[:, None] <= last_px + slack_px) & (right[:, None] >= first_px - slack_px)
        # All tiles of a box that is one tile wide or high are listed.
        large = (listed.any(axis=1).sum(axis=1) > 1) & (listed.any(axis=2).sum(axis=1) > 1)
        assert not (listed[large, row] & ~reached[large]).any()


def test_turns_number_the_pairs_of_each_gaussian():
    means, factors, opacities, depths = ellipses(300, 20.0, seed=1)
    order = np.argsort(depths).astype(np.int32)
    splats = pack_splats(
        means.astype(np.float32), np.zeros((300, 2), np.float32), factors,
        opacities.astype(np.float32), np.zeros((300, 3), np.float32), np.full((300, 2), 1 << 20, np.int32),
        TILES_X, TILES_Y,
    )  # fmt: skip
    tiles = assign_tiles(splats, order, TILES_X, np.ones(TILES_X * TILES_Y, np.bool_))
    ids = tiles.ids[: len(tiles.pair_ranks)]
    for rank, gaussian in enumerate(order):
        assert tiles.pair_ranks[ids == gaussian].tolist() == list(range(tiles.pairs[rank]))


def test_done_tiles_get_nothing_and_the_preset_s_extent_cuts():
    means = np.array([[60.0, 40.0]], np.float32)
    factors, opacities = np.array([[0.02, 0.0, 0.02]]), np.array([0.9], np.float32)

    def tiles(radius, alive):
        splats = pack_splats(
            means, np.zeros_like(means), factors, opacities, np.zeros((1, 1), np.float32),
            np.full((1, 2), radius, np.int32), TILES_X, TILES_Y,
        )  # fmt: skip
        return np.flatnonzero(np.diff(assign_tiles(splats, np.zeros(1, np.int32), TILES_X, alive).tile_starts))

    every = np.ones(TILES_X * TILES_Y, np.bool_)
    assert len(tiles(1 << 20, every)) == TILES_X * TILES_Y
    assert tiles(5, every).tolist() == [2 * TILES_X + 3, 2 * TILES_X + 4]
    only = every & False
    only[7] = True
    assert tiles(1 << 20, only).tolist() == [7]
