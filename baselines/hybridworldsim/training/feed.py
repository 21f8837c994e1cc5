"""Training pictures from the dataset, one after the other: decoded ahead by a thread, memory bounded."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Final

import numpy as np
import torch

from hybridworldsim.training.picture import TrainingPicture
from hybridworldsim.training.viewpoint import viewpoint_of
from mirror.arrays import Float64
from mirror.dataset.dataset import Dataset
from mirror.errors import DatasetError
from mirror.evaluation.truth.raster import raster_of
from mirror.evaluation.truth.source import TruthSource
from mirror.evaluation.views.plan import Plan
from mirror.evaluation.views.view import View

CACHE_BYTES: Final = 512 << 20
_AHEAD: Final = 3


class Pictures:
    """Opens training pictures of views; those opened last are held, up to a number of bytes.

    Args:
        dataset: where they lie.
        plan: whose protocol says raster and masks.
        origin_m: (3,) of the block, in the world.
        cache_bytes: held at most; memory does not grow with the number of pictures beyond it.
        sky: read masks of the sky too, for a method that learns from them.
        depth: read depth maps too; held-out traversals have none of the layer that is chosen for training.
    """

    def __init__(
        self,
        dataset: Dataset,
        plan: Plan,
        origin_m: Float64,
        cache_bytes: int = CACHE_BYTES,
        *,
        sky: bool = False,
        depth: bool = True,
    ) -> None:
        self._plan, self._origin, self._most = plan, origin_m, cache_bytes
        self._sky, self._depth = sky, depth
        self._source = TruthSource(dataset, plan.protocol, plan.layers)
        self._held: OrderedDict[str, TrainingPicture] = OrderedDict()
        self._bytes = 0
        self.opened = 0

    def __call__(self, view: View) -> TrainingPicture:
        """The picture of a view.

        Raises:
            DatasetError: a file is missing or broken, or nothing of it may be learnt from and that is all there is.
        """
        if view.path in self._held:
            self._held.move_to_end(view.path)
            return self._held[view.path]
        picture = self._open(view)
        self.opened += 1
        self._held[view.path] = picture
        self._bytes += picture.bytes
        while self._bytes > self._most and len(self._held) > 1:
            _, old = self._held.popitem(last=False)
            self._bytes -= old.bytes
        return picture

    def _open(self, view: View) -> TrainingPicture:
        rgb = self._source.picture(view)
        _, image = self._source.recorded(view)
        raster = raster_of(image.camera_model, self._plan.protocol.pixels)
        sky = None
        for mask in image.masks() if self._sky else ():
            if mask.kind == "sky":
                sky = torch.from_numpy(~raster.excluded(mask.decode() == 0))
        depth = image.depth() if self._depth else None
        depth_m = None
        if depth is not None:
            metres = np.nan_to_num(depth.decode(), nan=0.0)
            if metres.shape != rgb.shape[:2]:
                rows = ((np.arange(rgb.shape[0]) + 0.5) * metres.shape[0] / rgb.shape[0]).astype(np.int64)
                columns = ((np.arange(rgb.shape[1]) + 0.5) * metres.shape[1] / rgb.shape[1]).astype(np.int64)
                metres = metres[rows[:, None], columns]
            depth_m = torch.from_numpy(np.ascontiguousarray(metres, np.float32))
        return TrainingPicture(
            viewpoint_of(view, self._origin),
            torch.from_numpy(rgb).to(torch.float32).div_(255.0),
            torch.from_numpy(self._source.scored(view)),
            sky,
            depth_m,
            view.path,
        )


def order(seed: int, count: int, first: int) -> Iterator[int]:
    """Every picture once in each round, every round in another order, which depends on the seed and the round alone.

    Args:
        seed: of the orders.
        count: how many pictures.
        first: how many have been shown already.
    """
    epoch, place = divmod(first, count)
    while True:
        rows = np.random.default_rng([seed, epoch]).permutation(count)
        yield from rows[place:].tolist()
        epoch, place = epoch + 1, 0


def stream(pictures: Pictures, views: Sequence[View], seed: int, first: int) -> Generator[TrainingPicture, None, None]:
    """Training pictures without end, in the order of `order`; a thread opens the next ones meanwhile.

    Raises:
        DatasetError: not one picture has a pixel to learn from; or a file is missing or broken.
    """
    barren: set[int] = set()
    places = order(seed, len(views), first)
    with ThreadPoolExecutor(1, "pictures") as ahead:
        waiting: list[tuple[int, Future[TrainingPicture]]] = []
        try:
            while True:
                while len(waiting) < _AHEAD:
                    place = next(places)
                    waiting.append((place, ahead.submit(pictures, views[place])))
                place, future = waiting.pop(0)
                picture = future.result()
                if not picture.scored.any():
                    barren.add(place)
                    if len(barren) == len(views):
                        raise DatasetError(
                            "masks cover every training picture", expected="pixels of the static street",
                            remedy="look at the masks: road users, the vehicle itself, and what the lens does not see",
                        )  # fmt: skip
                yield picture
        finally:
            ahead.shutdown(wait=True, cancel_futures=True)
