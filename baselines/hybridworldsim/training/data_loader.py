"""Training images from the dataset, one after the other: decoded ahead by a thread, memory bounded."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Generator, Iterator, Sequence, Set
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Final

import numpy as np
import torch

from hybridworldsim.training.training_image import TrainingImage
from hybridworldsim.training.viewpoint import to_viewpoint
from mirror.arrays import Float32, Float64
from mirror.dataset.dataset import Dataset
from mirror.dataset.image import DepthImage, Image, Mask
from mirror.errors import DatasetError
from mirror.geometry.cameras import Camera
from mirror.protocols.truth.raster import cached_raster
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView

CACHE_BYTES: Final = 512 << 20
_AHEAD: Final = 3


class TrainingImageCache:
    """Opens training images of views; those opened last are held, up to a number of bytes.

    Args:
        dataset: where they lie.
        plan: whose protocol says raster and masks.
        origin_m: (3,) of the block, in the world.
        depth_of: traversals whose depth maps are read, of the chosen layer; others have none.
        sky: read masks of the sky too, for a method that learns from them.
        cache_bytes: held at most; memory does not grow with the number of images beyond it.

    Attributes:
        held_bytes: of images that are held now.
        opened: images that were opened so far, those that were opened again among them.
    """

    def __init__(
        self,
        dataset: Dataset,
        plan: Plan,
        origin_m: Float64,
        depth_of: Set[str] = frozenset(),
        *,
        sky: bool = False,
        cache_bytes: int = CACHE_BYTES,
    ) -> None:
        self._plan, self._origin, self._most = plan, origin_m, cache_bytes
        self._sky, self._depth_of = sky, depth_of
        self._source = GroundTruth(dataset, plan.protocol, plan.layers)
        self._held: OrderedDict[str, TrainingImage] = OrderedDict()
        self.held_bytes = 0
        self.opened = 0

    def __call__(self, view: RenderView) -> TrainingImage:
        """The image of a view.

        Raises:
            DatasetError: a file is missing or broken, or it has several masks of the sky.
            UsageError: it has several layers of depth and none was chosen.
        """
        if view.path not in self._held:
            self._held[view.path] = self._open(view)
            self.opened += 1
            self.held_bytes += self._held[view.path].bytes
        self._held.move_to_end(view.path)
        while self.held_bytes > self._most and len(self._held) > 1:
            _, old = self._held.popitem(last=False)
            self.held_bytes -= old.bytes
        recorded = self._held[view.path]
        # Held as it was recorded: in float32 colours would take four times the bytes.
        return replace(recorded, rgb=recorded.rgb.to(torch.float32).div_(255.0))

    def _open(self, view: RenderView) -> TrainingImage:
        """The image of a view, its colours as they were recorded: uint8."""
        rgb = self._source.image(view)
        _, image = self._source.recorded_frame_and_image(view)
        depth = image.depth() if view.traversal_id in self._depth_of else None
        mask, sky = _sky(image, depth) if self._sky else None, None
        if mask is not None:
            raster = cached_raster(image.camera_model, self._plan.protocol.pixels)
            sky = torch.from_numpy(~raster.exclude(mask.decode() == 0))
        depth_m = None if depth is None else torch.from_numpy(resample_depth(view, depth.lens, depth.decode()))
        return TrainingImage(
            to_viewpoint(view, self._origin),
            torch.from_numpy(rgb),
            torch.from_numpy(self._source.scored_mask(view)),
            sky,
            depth_m,
            view.path,
        )


def resample_depth(view: RenderView, lens: Camera, depth_m: Float32) -> Float32:
    """A depth map as a view's lens has it.

    Args:
        view: of the same pose; a pinhole.
        lens: the map's pinhole.
        depth_m: (H, W) the camera's z, NaN where unknown.

    Returns:
        (height, width) of the view, of the nearest pixel of the map; 0 where that is not known.
    """
    across = lens.fx_px * (np.arange(view.width_px) + 0.5 - view.cx_px) / view.fx_px + lens.cx_px
    down = lens.fy_px * (np.arange(view.height_px) + 0.5 - view.cy_px) / view.fy_px + lens.cy_px
    # Centres that fall on an edge between two pixels belong to the second, whatever rounding says.
    columns, rows = (np.floor(places + 1e-6).astype(np.int64) for places in (across, down))
    columns_in, rows_in = (columns >= 0) & (columns < lens.width_px), (rows >= 0) & (rows < lens.height_px)
    found = np.zeros((view.height_px, view.width_px), np.float32)
    found[np.ix_(rows_in, columns_in)] = np.nan_to_num(depth_m[np.ix_(rows[rows_in], columns[columns_in])], nan=0.0)
    return found


def _sky(image: Image, depth: DepthImage | None) -> Mask | None:
    """The image's mask of the sky; of several that which was made with the depth map."""
    masks = [mask for mask in image.masks() if mask.kind == "sky"]
    if len(masks) > 1 and depth is not None:
        made = depth.source, depth.source_version
        masks = [mask for mask in masks if (mask.source, mask.source_version) == made] or masks
    if len(masks) > 1:
        raise DatasetError(
            f"{len(masks)} masks of the sky: {', '.join(f'{one.source}@{one.source_version}' for one in masks)}",
            place=f"camera {image.camera}, timestamp_ns {image.timestamp_ns}", expected="one of the depth map's layer",
        )  # fmt: skip
    return masks[0] if masks else None


def order(seed: int, count: int, first: int) -> Iterator[int]:
    """Every image once in each round, every round in another order, which depends on the seed and the round alone.

    Args:
        seed: of the orders.
        count: how many images.
        first: how many have been shown already.
    """
    epoch, place = divmod(first, count)
    while True:
        rows = np.random.default_rng([seed, epoch]).permutation(count)
        yield from rows[place:].tolist()
        epoch, place = epoch + 1, 0


class NoSupervisionError(DatasetError):
    """Not one image has a pixel to learn from."""


def stream(
    images: TrainingImageCache, views: Sequence[RenderView], seed: int, first: int
) -> Generator[TrainingImage, None, None]:
    """Training images without end, in the order of `order`; a thread opens the next ones meanwhile.

    Raises:
        NoSupervisionError: not one image has a pixel to learn from.
        DatasetError: a file is missing or broken.
    """
    barren: set[int] = set()
    places = order(seed, len(views), first)
    with ThreadPoolExecutor(1, "pictures") as ahead:
        waiting: list[tuple[int, Future[TrainingImage]]] = []
        try:
            while True:
                while len(waiting) < _AHEAD:
                    place = next(places)
                    waiting.append((place, ahead.submit(images, views[place])))
                place, future = waiting.pop(0)
                image = future.result()
                if not image.scored.any():
                    barren.add(place)
                    if len(barren) == len(views):
                        raise NoSupervisionError(
                            "masks cover every training image", expected="pixels of the static street",
                            remedy="look at the masks: road users, the vehicle itself, and what the lens does not see",
                        )  # fmt: skip
                yield image
        finally:
            ahead.shutdown(wait=True, cancel_futures=True)
