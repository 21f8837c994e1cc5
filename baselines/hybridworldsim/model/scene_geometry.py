"""Initial geometry of a block from a dataset's layers: points, driven lines, and the ground through them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hybridworldsim.model.blocks import Block
from hybridworldsim.model.initialization import InitialGeometry
from hybridworldsim.mvs.ground import FittedGround, compute_wheel_contacts, fit_ground, read_driven_poses
from hybridworldsim.trainable.viewpoint import Source
from mirror.arrays import Float64, UInt8
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError


def driven_m(dataset: Dataset) -> Float64:
    """Return the places (N, 3) of vehicles on the ground in the traversals of a dataset view, in the world."""
    return read_driven_poses(dataset).translation


FEW_POINTS: Final = 50
"""Fewer points of a scene than this are matches by chance: photos that hardly overlap, or wrong poses."""


@dataclass(frozen=True, eq=False)
class SceneGeometry:
    """The geometry of a scene before training, in the world.

    Attributes:
        points_m: (P, 3) points that do not lie on the ground.
        points_rgb: (P, 3) their colours.
        driven_m: (N, 3) places of vehicles on the ground.
        ground: surface through the driven places and the ground points.
        ground_count: number of the ground points.
    """

    points_m: Float64
    points_rgb: UInt8
    driven_m: Float64
    ground: FittedGround
    ground_count: int = 0

    @property
    def few_points(self) -> str | None:
        """A warning if there are too few points to tell where the scene is; else None."""
        count = len(self.points_m) + self.ground_count
        if count >= FEW_POINTS:
            return None
        return (
            f"warning: the scene has {count} points, fewer than {FEW_POINTS}: the model starts from nearly nothing, and"
            " its views will be poor; check the images and their poses (`mirror check`), or initialise with more points"
            " (--initialise)"
        )


def read_scene_geometry(dataset: Dataset) -> SceneGeometry:
    """Read the geometry of a scene.

    Args:
        dataset: a view of the training traversals of one scene, without held-out ones.

    Raises:
        DatasetError: the traversals have no points, or points that are not finite.
        UsageError: they have several layers of points and none was chosen.
    """
    points = dataset.points()
    if not len(points):
        layer = dataset.layers.points
        raise DatasetError(
            f"no points in the {dataset.count('traversals')} training traversals", file=dataset.root,
            place=f"scene {', '.join(dataset.scenes())}", expected="a layer of points",
            remedy=f"{layer} matched no point: check images, masks and poses, or try another --initialise"
            if layer else "estimate one from the images: --initialise plane-sweep",
        )  # fmt: skip
    if invalid_count := int((~np.isfinite(points.position_m)).any(axis=1).sum()):
        raise DatasetError(
            f"{invalid_count} of {len(points)} points are not finite", file=dataset.root,
            place=f"scene {', '.join(dataset.scenes())}, layer of points {dataset.layers.points or 'that is there'}",
            expected="metres in the scene's world", remedy="`mirror check` names the file; make the layer again",
        )  # fmt: skip
    on_ground = np.array(points.kind) == "ground"
    ground = fit_ground(compute_wheel_contacts(read_driven_poses(dataset)), points.position_m[on_ground])
    return SceneGeometry(
        points.position_m[~on_ground], points.rgb[~on_ground], driven_m(dataset), ground, int(on_ground.sum())
    )


def block_geometry(scene: SceneGeometry, block: Block, sources: Sequence[Source]) -> InitialGeometry:
    """Select the geometry of a block from the geometry of its scene.

    Args:
        scene: geometry of the scene.
        block: a block of the scene.
        sources: traversals and cameras of the block's training images.

    Returns:
        Points inside and beyond the block, driven places and the ground, all in the block's frame.
    """
    origin = np.array(block.origin_m)

    def surface(places_m: Float64) -> tuple[Float64, Float64]:
        world = places_m + origin[:2]
        return scene.ground.height(world) - origin[2], scene.ground.normal(world)

    far = block.far(scene.points_m)
    return InitialGeometry(
        block.local(scene.points_m[~far]),
        block.local(scene.points_m[far]),
        _driven_inside(block, block.local(scene.driven_m)),
        surface,
        block.half_extent_m,
        sources,
        scene.points_rgb[~far],
    )


def _driven_inside(block: Block, driven: Float64) -> Float64:
    """Driven places within the block's geometry; the nearest place if there is none."""
    beyond = np.abs(driven[:, :2]).max(axis=1)
    return driven[beyond <= max(block.half_extent_m, float(beyond.min()))]
