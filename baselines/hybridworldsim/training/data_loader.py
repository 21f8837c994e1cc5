"""Loads training images from the dataset: threads decode ahead, and memory, also that of a GPU, is bounded."""

from __future__ import annotations

import threading
from collections.abc import Generator, Iterator, Sequence, Set
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Final

import numpy as np
import torch

from hybridworldsim.kept_items import KeptItems
from hybridworldsim.trainable.training_image import TrainingImage
from hybridworldsim.trainable.viewpoint import to_viewpoint
from mirror.arrays import Float32, Float64
from mirror.dataset.dataset import Dataset
from mirror.dataset.image import DepthImage, Image, Mask
from mirror.devices import CPU
from mirror.errors import DatasetError
from mirror.geometry.cameras import Camera
from mirror.protocols.truth.raster import cached_raster
from mirror.protocols.truth.source import GroundTruth
from mirror.protocols.views.plan import Plan
from mirror.protocols.views.view import RenderView

CACHE_BYTES: Final = 512 << 20
"""Bytes of images that are kept in memory on a CPU."""
GPU_CACHE_BYTES: Final = 4 << 30
"""The same on a GPU, in its memory: a thousand images of 960 x 540 with depth."""
GPU_WORKERS: Final = 4
"""Threads that decode images for a GPU, which trains on one in the time in which a core decodes one or less."""
_PREFETCHED: Final = 2
"""Images that wait for each thread, besides the one that it decodes."""


class TrainingImageCache:
    """A cache that opens the training images of views, and keeps the latest up to a number of bytes.

    Args:
        dataset: the dataset.
        plan: its protocol states raster and masks.
        origin_m: (3,) origin of the block, in the world.
        depth_of: traversals with the chosen layer of depth maps; no depth is read for others.
        sky: whether to read masks of the sky, for a method that learns from them.
        cache_bytes: limit of the cache; memory does not grow with the number of images beyond it. None: `CACHE_BYTES`,
            or `GPU_CACHE_BYTES` on a GPU.
        device: where the images wait; on a GPU they are copied there from pinned memory, and stay.
    """

    def __init__(
        self,
        dataset: Dataset,
        plan: Plan,
        origin_m: Float64,
        depth_of: Set[str] = frozenset(),
        *,
        sky: bool = False,
        cache_bytes: int | None = None,
        device: str = CPU,
    ) -> None:
        self._plan, self._origin, self._device = plan, origin_m, torch.device(device)
        self._reads_sky, self._depth_of = sky, depth_of
        self._dataset, self._local = dataset, threading.local()
        bound = GPU_CACHE_BYTES if self._device.type != CPU else CACHE_BYTES
        self._cache: KeptItems[str, TrainingImage] = KeptItems(bound if cache_bytes is None else cache_bytes)

    @property
    def held_bytes(self) -> int:
        """Return the size of the cached images."""
        return self._cache.held

    @property
    def opened(self) -> int:
        """Return the number of images opened so far, including repeated openings."""
        return self._cache.made

    def __call__(self, view: RenderView) -> TrainingImage:
        """The image of a view.

        Raises:
            DatasetError: a file is missing or broken, or the image has several masks of the sky.
            UsageError: the image has several layers of depth and none was chosen.
        """
        recorded = self._cache.get(view.path, lambda: self._place(self._open(view)), lambda image: image.bytes)
        # The cache holds uint8: float32 colours would take four times the bytes.
        return replace(recorded, rgb=recorded.rgb.to(torch.float32).div_(255.0))

    def _place(self, image: TrainingImage) -> TrainingImage:
        """Copy an image to the device; what would have to be read back from a GPU is examined before."""
        if self._device.type == CPU:
            return image
        image.require_finite()
        return (image.pinned() if self._device.type == "cuda" else image).to(self._device)

    @property
    def _source(self) -> GroundTruth:
        """The truth that this thread reads: it keeps files of a traversal open."""
        if not hasattr(self._local, "source"):
            self._local.source = GroundTruth(self._dataset, self._plan.protocol, self._plan.layers)
        source: GroundTruth = self._local.source
        return source

    def _open(self, view: RenderView) -> TrainingImage:
        """Open the image of a view, with recorded colours (uint8)."""
        source = self._source
        rgb = source.image(view)
        _, image = source.recorded_frame_and_image(view)
        depth = image.depth() if view.traversal_id in self._depth_of else None
        mask, sky = _select_sky_mask(image, depth) if self._reads_sky else None, None
        if mask is not None:
            raster = cached_raster(image.camera_model, self._plan.protocol.pixels)
            sky = torch.from_numpy(~raster.exclude(mask.decode() == 0))
        depth_m = None if depth is None else torch.from_numpy(resample_depth(view, depth.lens, depth.decode()))
        return TrainingImage(
            to_viewpoint(view, self._origin),
            torch.from_numpy(rgb),
            torch.from_numpy(source.scored_mask(view)),
            sky,
            depth_m,
            view.path,
        )


def resample_depth(view: RenderView, lens: Camera, depth_m: Float32) -> Float32:
    """Resample a depth map to the raster of a view.

    Args:
        view: a pinhole view with the pose of the map.
        lens: pinhole lens of the map.
        depth_m: (H, W) camera z, NaN where unknown.

    Returns:
        (height, width) of the view: depth of the nearest pixel of the map, 0 where unknown.
    """
    columns_px = lens.fx_px * (np.arange(view.width_px) + 0.5 - view.cx_px) / view.fx_px + lens.cx_px
    rows_px = lens.fy_px * (np.arange(view.height_px) + 0.5 - view.cy_px) / view.fy_px + lens.cy_px
    # A centre on the edge between two pixels belongs to the second, despite rounding.
    columns, rows = (np.floor(places + 1e-6).astype(np.int64) for places in (columns_px, rows_px))
    columns_in, rows_in = (columns >= 0) & (columns < lens.width_px), (rows >= 0) & (rows < lens.height_px)
    resampled = np.zeros((view.height_px, view.width_px), np.float32)
    resampled[np.ix_(rows_in, columns_in)] = np.nan_to_num(depth_m[np.ix_(rows[rows_in], columns[columns_in])], nan=0.0)
    return resampled


def _select_sky_mask(image: Image, depth: DepthImage | None) -> Mask | None:
    """The image's mask of the sky; of several, the one from the layer of the depth map."""
    masks = [mask for mask in image.masks() if mask.kind == "sky"]
    if len(masks) > 1 and depth is not None:
        depth_layer = depth.source, depth.source_version
        masks = [mask for mask in masks if (mask.source, mask.source_version) == depth_layer] or masks
    if len(masks) > 1:
        raise DatasetError(
            f"{len(masks)} masks of the sky: {', '.join(f'{one.source}@{one.source_version}' for one in masks)}",
            place=f"camera {image.camera}, timestamp_ns {image.timestamp_ns}", expected="one of the depth map's layer",
        )  # fmt: skip
    return masks[0] if masks else None


def shuffled_indices(seed: int, count: int, first: int) -> Iterator[int]:
    """Yield every image once in each epoch; the order depends on the seed and the epoch only.

    Args:
        seed: seed of the orders.
        count: number of images.
        first: number of images already shown.
    """
    epoch, place = divmod(first, count)
    while True:
        rows = np.random.default_rng([seed, epoch]).permutation(count)
        yield from rows[place:].tolist()
        epoch, place = epoch + 1, 0


class NoSupervisionError(DatasetError):
    """No image has a pixel to learn from."""


def stream_images(
    images: TrainingImageCache, views: Sequence[RenderView], seed: int, first: int, workers: int = 1
) -> Generator[TrainingImage, None, None]:
    """Yield training images without end, in the order of `shuffled_indices`, while threads open the next ones.

    Args:
        images: opens the images.
        views: training views.
        seed: seed of the orders.
        first: number of images already shown.
        workers: number of threads; the order does not depend on it.

    Raises:
        NoSupervisionError: no image has a pixel to learn from.
        DatasetError: a file is missing or broken.
    """
    unscored: set[int] = set()
    places = shuffled_indices(seed, len(views), first)
    with ThreadPoolExecutor(workers, "images") as executor:
        waiting: list[tuple[int, Future[TrainingImage]]] = []
        try:
            while True:
                while len(waiting) < workers * _PREFETCHED + 1:
                    place = next(places)
                    waiting.append((place, executor.submit(images, views[place])))
                place, future = waiting.pop(0)
                image = future.result()
                if not image.teaches:
                    unscored.add(place)
                    if len(unscored) == len(views):
                        raise NoSupervisionError(
                            "masks cover every training image", expected="pixels of the static street",
                            remedy="check the masks of road users, of the vehicle itself and of the lens border",
                        )  # fmt: skip
                yield image
        finally:
            executor.shutdown(wait=True, cancel_futures=True)
