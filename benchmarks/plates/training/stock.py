"""A stock of samples that processes fill without end, and from which batches are drawn."""

from __future__ import annotations

import mmap
import multiprocessing
import threading
from collections.abc import Iterator
from pathlib import Path
from queue import Queue
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from mirror.arrays import AnyArray

MOST: Final = 8
"""Number of plates of a sample, padded."""
Batch = tuple[Tensor, Tensor, Tensor]
"""Images (B, S, S, 3), boxes (B, MOST, 4), and state (B, MOST): 0 none, 1 a plate, 2 an ignored one."""


class Stock:
    """Samples in memory that all processes share.

    Args:
        glyphs: file of the masks.
        backgrounds: file of the backgrounds.
        slots: number of samples that are kept; a new one replaces the oldest.
        side_px: side of a sample.
        workers: number of processes.
        seed: seed of the samples.
    """

    def __init__(self, glyphs: Path, backgrounds: Path, slots: int, side_px: int, workers: int, seed: int) -> None:
        self._images: AnyArray = _shared((slots, side_px, side_px, 3), np.uint8)
        self._boxes: AnyArray = _shared((slots, MOST, 4), np.float32)
        self._states: AnyArray = _shared((slots, MOST), np.uint8)
        self._made: AnyArray = _shared((slots,), np.int64)
        context = multiprocessing.get_context("fork")
        arrays = (self._images, self._boxes, self._states, self._made)
        self._processes = [
            context.Process(target=_fill, args=(arrays, glyphs, backgrounds, side_px, one, workers, seed), daemon=True)
            for one in range(workers)
        ]
        for process in self._processes:
            process.start()

    @property
    def made(self) -> int:
        """Number of samples that were made so far."""
        return int(self._made.sum())

    @property
    def full(self) -> int:
        """Number of slots with a sample."""
        return int((self._made > 0).sum())

    def batches(self, size: int, *, pinned: bool, ahead: int = 4) -> Iterator[Batch]:
        """Yield batches without end, made by a thread.

        Args:
            size: number of samples.
            pinned: whether images lie in memory that a GPU reads.
            ahead: number of batches that are made in advance.
        """
        rng, queue = np.random.default_rng(), Queue[Batch](ahead)

        def work() -> None:
            while True:
                rows = np.flatnonzero(self._made > 0)
                chosen = rng.choice(rows, size, replace=len(rows) < size)
                parts = [torch.from_numpy(stored[chosen]) for stored in (self._images, self._boxes, self._states)]
                queue.put(tuple(part.pin_memory() if pinned else part for part in parts))  # type: ignore[arg-type]

        threading.Thread(target=work, daemon=True).start()
        while True:
            yield queue.get()

    def close(self) -> None:
        """End the processes."""
        for process in self._processes:
            process.terminate()
            process.join()


def _fill(
    arrays: tuple[AnyArray, ...], glyphs: Path, backgrounds: Path, side_px: int, worker: int, workers: int, seed: int
) -> None:
    """Fill the slots of one process, round and round."""
    import cv2

    from benchmarks.plates.backgrounds import load_backgrounds
    from benchmarks.plates.fonts import load_glyphs
    from benchmarks.plates.samples import draw_sample

    cv2.setNumThreads(1)
    masks, streets = load_glyphs(glyphs), load_backgrounds(backgrounds)
    images, boxes, states, made = arrays
    own = np.arange(worker, len(images), workers)
    number = 0
    while True:
        for slot in own:
            sample = draw_sample(masks, streets, np.random.default_rng([seed, worker, number]), side_px)
            count = min(len(sample.boxes), MOST)
            images[slot], states[slot] = sample.image, 0
            boxes[slot, :count] = sample.boxes[:count]
            states[slot, :count] = np.where(sample.ignored[:count], 2, 1)
            made[slot] += 1
            number += 1


def _shared(shape: tuple[int, ...], kind: Any) -> AnyArray:
    """An array of zeros that forked processes share."""
    count = int(np.prod(shape))
    return np.frombuffer(mmap.mmap(-1, count * np.dtype(kind).itemsize), kind, count).reshape(shape)
