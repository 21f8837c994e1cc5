"""What a block begins with, of a dataset's layers: points, driven lines, the ground through them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hybridworldsim.mvs.ground import fit_ground, wheel_places
from hybridworldsim.scene.blocks import Block
from hybridworldsim.scene.seeding import Initial
from hybridworldsim.training.viewpoint import Source
from mirror.arrays import Float64
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError
from mirror.geometry.poses import Poses

_COLUMNS = ("qw", "qx", "qy", "qz", "tx_m", "ty_m", "tz_m")


def driven_m(dataset: Dataset) -> Float64:
    """(N, 3) where vehicles drove in the traversals of a view, on the ground, in the world."""
    return _poses(dataset).translation


def _poses(dataset: Dataset) -> Poses:
    table = dataset.table("ego_poses", _COLUMNS)
    numbers = np.stack([column.to_numpy() for column in table.columns], axis=1).astype(np.float64)
    return Poses(numbers[:, :4], numbers[:, 4:])


def initial_of(dataset: Dataset, block: Block, sources: Sequence[Source]) -> Initial:
    """What is known of a block before it is trained.

    Args:
        dataset: a view of the training traversals of one scene, and nothing else: no held-out one leaks in.
        block: of the scene.
        sources: whose pictures it is trained on.

    Raises:
        DatasetError: the traversals have no points.
        UsageError: they have several layers of points, and none was chosen.
    """
    points = dataset.points()
    if not len(points):
        made = dataset.layers.points
        raise DatasetError(
            f"no points in the {dataset.count('traversals')} training traversals", file=dataset.root,
            place=f"scene {', '.join(dataset.scenes())}", expected="a layer of points",
            remedy=f"{made} found nothing to match: look at pictures, masks and poses, or try another --initialise"
            if made else "make one of the pictures: --initialise plane-sweep",
        )  # fmt: skip
    driven = driven_m(dataset)
    kind = np.array(points.kind)
    on_ground = kind == "ground"
    ground = fit_ground(wheel_places(_poses(dataset)), points.position_m[on_ground])
    origin = np.array(block.origin_m)

    def surface(places_m: Float64) -> tuple[Float64, Float64]:
        world = places_m + origin[:2]
        return ground.height(world) - origin[2], ground.normal(world)

    far = block.far(points.position_m) & ~on_ground
    near = ~far & ~on_ground
    return Initial(
        block.local(points.position_m[near]),
        block.local(points.position_m[far]),
        _within(block, block.local(driven)),
        surface,
        block.near_m,
        sources,
        points.rgb[near],
    )


def _within(block: Block, driven: Float64) -> Float64:
    """Driven places that a block holds geometry of; the nearest one, if it holds none."""
    beyond = np.abs(driven[:, :2]).max(axis=1)
    return driven[beyond <= max(block.near_m, float(beyond.min()))]
