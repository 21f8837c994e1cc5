"""What a block begins with, of a dataset's layers: points, driven lines, the ground through them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hybridworldsim.model.blocks import Block
from hybridworldsim.model.initialization import InitialGeometry
from hybridworldsim.mvs.ground import Ground, compute_wheel_contacts, fit_ground, read_driven_poses
from hybridworldsim.training.viewpoint import Source
from mirror.arrays import Float64, UInt8
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError


def driven_m(dataset: Dataset) -> Float64:
    """(N, 3) where vehicles drove in the traversals of a view, on the ground, in the world."""
    return read_driven_poses(dataset).translation


@dataclass(frozen=True, eq=False)
class SceneGeometry:
    """What is known of a scene before any of its blocks is trained, in the world.

    Attributes:
        points_m: (P, 3) that do not lie on the ground.
        points_rgb: (P, 3) their colours.
        driven_m: (N, 3) where vehicles drove.
        ground: through them and the points that lie on it.
    """

    points_m: Float64
    points_rgb: UInt8
    driven_m: Float64
    ground: Ground


def read_scene_geometry(dataset: Dataset) -> SceneGeometry:
    """What is known of a scene.

    Args:
        dataset: a view of the training traversals of one scene, and nothing else: no held-out one leaks in.

    Raises:
        DatasetError: the traversals have no points, or some that are no finite numbers.
        UsageError: they have several layers of points, and none was chosen.
    """
    points = dataset.points()
    if not len(points):
        made = dataset.layers.points
        raise DatasetError(
            f"no points in the {dataset.count('traversals')} training traversals", file=dataset.root,
            place=f"scene {', '.join(dataset.scenes())}", expected="a layer of points",
            remedy=f"{made} found nothing to match: look at images, masks and poses, or try another --initialise"
            if made else "make one of the images: --initialise plane-sweep",
        )  # fmt: skip
    if wrong := int((~np.isfinite(points.position_m)).any(axis=1).sum()):
        raise DatasetError(
            f"{wrong} of {len(points)} points are no finite numbers", file=dataset.root,
            place=f"scene {', '.join(dataset.scenes())}, layer of points {dataset.layers.points or 'that is there'}",
            expected="metres in the scene's world", remedy="`mirror check` names the file; make the layer anew",
        )  # fmt: skip
    on_ground = np.array(points.kind) == "ground"
    ground = fit_ground(compute_wheel_contacts(read_driven_poses(dataset)), points.position_m[on_ground])
    return SceneGeometry(points.position_m[~on_ground], points.rgb[~on_ground], driven_m(dataset), ground)


def block_geometry(known: SceneGeometry, block: Block, sources: Sequence[Source]) -> InitialGeometry:
    """What is known of a block before it is trained.

    Args:
        known: of the scene.
        block: of it.
        sources: whose images the block is trained on.

    Returns:
        All in the block's frame: points in it, points beyond it, driven places, the ground.
    """
    origin = np.array(block.origin_m)

    def surface(places_m: Float64) -> tuple[Float64, Float64]:
        world = places_m + origin[:2]
        return known.ground.height(world) - origin[2], known.ground.normal(world)

    far = block.far(known.points_m)
    return InitialGeometry(
        block.local(known.points_m[~far]),
        block.local(known.points_m[far]),
        _within(block, block.local(known.driven_m)),
        surface,
        block.half_extent_m,
        sources,
        known.points_rgb[~far],
    )


def _within(block: Block, driven: Float64) -> Float64:
    """Driven places that a block holds geometry of; the nearest one, if it holds none."""
    beyond = np.abs(driven[:, :2]).max(axis=1)
    return driven[beyond <= max(block.half_extent_m, float(beyond.min()))]
