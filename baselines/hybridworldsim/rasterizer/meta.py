"""The `meta` of `rasterization`: the keys that gsplat's strategies read, and counts."""

from __future__ import annotations

import math
import weakref
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from hybridworldsim.rasterizer.inputs import Inputs
from hybridworldsim.rasterizer.presets import GsplatPreset
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians
from hybridworldsim.rasterizer.rows import scatter_rows, take_rows


@dataclass(frozen=True, eq=False)
class BlendedView:
    """The Gaussians of one image, in the form in which they were blended.

    Attributes:
        scene_camera: index of the scene and index of the camera.
        projected: the M Gaussians that the image shows.
        opacities: (M,) opacities after compensation.
    """

    scene_camera: tuple[int, int]
    projected: ProjectedGaussians
    opacities: Tensor


@dataclass(frozen=True, eq=False, kw_only=True)
class Blending:
    """All images of one call, and the settings of their blending.

    Attributes:
        views: the B * C images.
        leading: leading dimensions of the image tensors, (..., C).
        width: width of the images, pixels.
        height: height of the images, pixels.
        tile_size: side of a tile, pixels.
        preset: the generation of gsplat.
        backend: name of the backend.
    """

    views: tuple[BlendedView, ...]
    leading: tuple[int, ...]
    width: int
    height: int
    tile_size: int
    preset: GsplatPreset
    backend: str

    def to_batch_shape(self, images: Tensor) -> Tensor:
        """Reshape (B * C, height, width, ...) to (..., C, height, width, ...)."""
        return images.reshape(*self.leading, *images.shape[1:])


class GaussianLayout:
    """The layout of the Gaussians of several images in one tensor: packed image by image, or (..., C, N).

    Args:
        inputs: the checked inputs.
        projected: the Gaussians of each of the B * C images.
        packed: whether the tensor is packed.
    """

    def __init__(self, inputs: Inputs, projected: Sequence[ProjectedGaussians], packed: bool) -> None:
        self._leading = (*inputs.batch, inputs.cameras)
        self._count = inputs.gaussians
        self._ids = [gaussians.ids for gaussians in projected]
        self._packed = packed

    def join(self, parts: Sequence[Tensor]) -> Tensor:
        """Join (M, ...) of each image to (nnz, ...), or to (..., C, N, ...) with zeros for invisible Gaussians."""
        if self._packed:
            return parts[0] if len(parts) == 1 else torch.cat(list(parts))
        tables = [scatter_rows(part, ids, self._count) for part, ids in zip(parts, self._ids, strict=True)]
        joined = tables[0][None] if len(tables) == 1 else torch.stack(tables)
        return joined.reshape(*self._leading, *joined.shape[1:])

    def split(self, joined: Tensor) -> list[Tensor]:
        """Split a joined tensor by image: the inverse of `join`."""
        if self._packed:
            return [joined] if len(self._ids) == 1 else list(joined.split([len(ids) for ids in self._ids]))
        tables = joined.reshape(len(self._ids), self._count, *joined.shape[len(self._leading) + 1 :])
        return [take_rows(table, ids) for table, ids in zip(tables, self._ids, strict=True)]

    def link_means2d(self, means2d: Sequence[Tensor], absgrad: bool) -> tuple[Tensor, list[Tensor]]:
        """Join the projected means of all images to one tensor that receives their gradients.

        Args:
            means2d: (M, 2) of each image.
            absgrad: whether blending sets `absgrad` of each part; the parts are then joined too.

        Returns:
            The joined tensor, and its part for each image, which is the input of blending.
        """
        joined = self.join(means2d)
        parts = self.split(joined)
        if absgrad and joined.requires_grad and parts[0] is not joined:
            # The graph holds the hook, and the parts hold the graph: weak references avoid a cycle.
            joined_reference, part_references = weakref.ref(joined), [weakref.ref(part) for part in parts]

            def collect(gradient: Tensor) -> None:
                if (tensor := joined_reference()) is not None:
                    # an image that the loss does not use has no absolute gradient
                    zero_gradients = [gradient.new_zeros(len(ids), 2) for ids in self._ids]
                    absolute = [
                        zeros if (part := reference()) is None else vars(part).pop("absgrad", zeros)
                        for reference, zeros in zip(part_references, zero_gradients, strict=True)
                    ]
                    vars(tensor)["absgrad"] = self.join(absolute)

            joined.register_hook(collect)
        return joined, parts

    def make_indices(self) -> dict[str, Tensor | None]:
        """Make the scene, camera and Gaussian index of each row of a packed tensor; None if not packed."""
        if not self._packed:
            return {"batch_ids": None, "camera_ids": None, "gaussian_ids": None}
        indices = [divmod(image, self._leading[-1]) for image in range(len(self._ids))]
        return {
            "batch_ids": self.join(
                [ids.new_tensor(scene).expand(len(ids)) for ids, (scene, _) in zip(self._ids, indices)]
            ),
            "camera_ids": self.join(
                [ids.new_tensor(camera).expand(len(ids)) for ids, (_, camera) in zip(self._ids, indices)]
            ),
            "gaussian_ids": self.join(self._ids),
        }


def make_meta(
    layout: GaussianLayout, means2d: Tensor, blending: Blending, counts: Iterable[dict[str, int]]
) -> dict[str, Any]:
    """Make gsplat's keys, and `counts` and `blending`.

    Args:
        layout: layout of tensors over Gaussians.
        means2d: the joined means, which receive gradients.
        blending: the blended Gaussians of each image.
        counts: counts of each step and image, which are added.
    """
    projected = [view.projected for view in blending.views]
    radii = layout.join([gaussians.radii for gaussians in projected])
    work: Counter[str] = Counter()
    for count in counts:
        work.update(count)
    return {
        **layout.make_indices(),
        # up to gsplat 1.4 an extent is a square with one radius
        "radii": radii[..., 0] if blending.preset.extent == "square" else radii,
        "means2d": means2d,
        "depths": layout.join([gaussians.depths for gaussians in projected]),
        "conics": layout.join([gaussians.conics.to(gaussians.means2d.dtype) for gaussians in projected]),
        "opacities": layout.join([view.opacities for view in blending.views]),
        "tile_width": math.ceil(blending.width / blending.tile_size),
        "tile_height": math.ceil(blending.height / blending.tile_size),
        "tile_size": blending.tile_size,
        "width": blending.width,
        "height": blending.height,
        "n_batches": math.prod(blending.leading[:-1]),
        "n_cameras": blending.leading[-1],
        "counts": dict(work),
        "blending": blending,
    }
