"""What `rasterization` tells besides its pictures: the keys that gsplat's strategies read, and counts."""

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
from hybridworldsim.rasterizer.presets import Preset
from hybridworldsim.rasterizer.projected_gaussians import ProjectedGaussians
from hybridworldsim.rasterizer.rows import scatter_rows, take_rows


@dataclass(frozen=True, eq=False)
class View:
    """The Gaussians of one image as they were blended.

    Attributes:
        place: which scene and which camera.
        projected: the M Gaussians that the picture shows.
        opacities: (M,) as blended.
    """

    place: tuple[int, int]
    projected: ProjectedGaussians
    opacities: Tensor


@dataclass(frozen=True, eq=False, kw_only=True)
class Blending:
    """All pictures of one call, and how they were blended.

    Attributes:
        views: B * C of them.
        leading: dimensions that they have in tensors, (..., C).
        width: pixels.
        height: pixels.
        tile_size: pixels.
        preset: whose rules.
        backend: who blended.
    """

    views: tuple[View, ...]
    leading: tuple[int, ...]
    width: int
    height: int
    tile_size: int
    preset: Preset
    backend: str

    def shaped(self, pictures: Tensor) -> Tensor:
        """(B * C, height, width, ...) as (..., C, height, width, ...)."""
        return pictures.reshape(*self.leading, *pictures.shape[1:])


class Layout:
    """How the Gaussians of several pictures lie in one tensor: packed one picture after the other, or (..., C, N).

    Args:
        inputs: what was given.
        seen: what each picture shows, B * C of them.
        packed: which of the two.
    """

    def __init__(self, inputs: Inputs, seen: Sequence[ProjectedGaussians], packed: bool) -> None:
        self._leading = (*inputs.batch, inputs.cameras)
        self._count = inputs.gaussians
        self._ids = [picture.ids for picture in seen]
        self._packed = packed

    def join(self, parts: Sequence[Tensor]) -> Tensor:
        """(M, ...) of each picture to (nnz, ...), or to (..., C, N, ...) with zeros where nothing is seen."""
        if self._packed:
            return parts[0] if len(parts) == 1 else torch.cat(list(parts))
        tables = [scatter_rows(part, ids, self._count) for part, ids in zip(parts, self._ids, strict=True)]
        whole = tables[0][None] if len(tables) == 1 else torch.stack(tables)
        return whole.reshape(*self._leading, *whole.shape[1:])

    def part(self, whole: Tensor) -> list[Tensor]:
        """What `join` joined, by picture."""
        if self._packed:
            return [whole] if len(self._ids) == 1 else list(whole.split([len(ids) for ids in self._ids]))
        tables = whole.reshape(len(self._ids), self._count, *whole.shape[len(self._leading) + 1 :])
        return [take_rows(table, ids) for table, ids in zip(tables, self._ids, strict=True)]

    def through(self, means2d: Sequence[Tensor], absgrad: bool) -> tuple[Tensor, list[Tensor]]:
        """Lead the projected means of all pictures through one tensor, which then receives their gradients.

        Args:
            means2d: (M, 2) of each picture.
            absgrad: whether blending sets `absgrad` of each part: it is then joined too.

        Returns:
            The tensor, and of each picture the part of it to blend with.
        """
        whole = self.join(means2d)
        parts = self.part(whole)
        if absgrad and whole.requires_grad and parts[0] is not whole:
            # The hook lives as long as the graph, which is held by the parts: it may not hold them in turn.
            held, blended = weakref.ref(whole), [weakref.ref(part) for part in parts]

            def collect(gradient: Tensor) -> None:
                if (tensor := held()) is not None:
                    # a picture that the loss leaves out has none
                    none = [gradient.new_zeros(len(ids), 2) for ids in self._ids]
                    absolute = [
                        zeros if (part := known()) is None else vars(part).pop("absgrad", zeros)
                        for known, zeros in zip(blended, none, strict=True)
                    ]
                    vars(tensor)["absgrad"] = self.join(absolute)

            whole.register_hook(collect)
        return whole, parts

    def indices(self) -> dict[str, Tensor | None]:
        """Which scene, camera and Gaussian each row of a packed tensor is; None if it is not packed."""
        if not self._packed:
            return {"batch_ids": None, "camera_ids": None, "gaussian_ids": None}
        places = [divmod(image, self._leading[-1]) for image in range(len(self._ids))]
        return {
            "batch_ids": self.join(
                [ids.new_tensor(scene).expand(len(ids)) for ids, (scene, _) in zip(self._ids, places)]
            ),
            "camera_ids": self.join(
                [ids.new_tensor(camera).expand(len(ids)) for ids, (_, camera) in zip(self._ids, places)]
            ),
            "gaussian_ids": self.join(self._ids),
        }


def make_meta(layout: Layout, means2d: Tensor, blending: Blending, counts: Iterable[dict[str, int]]) -> dict[str, Any]:
    """The keys that gsplat has, and `counts` and `blending`.

    Args:
        layout: of tensors over Gaussians.
        means2d: the tensor that the pictures' gradients pass through.
        blending: what each picture shows.
        counts: how much work was done and left out, of each step and picture.
    """
    projected = [view.projected for view in blending.views]
    radii = layout.join([picture.radii for picture in projected])
    work: Counter[str] = Counter()
    for count in counts:
        work.update(count)
    return {
        **layout.indices(),
        # to 1.4, gsplat's extents are squares, of one radius
        "radii": radii[..., 0] if blending.preset.extent == "square" else radii,
        "means2d": means2d,
        "depths": layout.join([picture.depths for picture in projected]),
        "conics": layout.join([picture.conics.to(picture.means2d.dtype) for picture in projected]),
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
