"""Decoding JPEG and PNG images, one by one or a camera set at once into planes."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache

import cv2
import numpy as np

from mirror.arrays import UInt8
from mirror.recordings.raster import has_end_marker


def decode_rgb(data: bytes, codec: str) -> UInt8 | None:
    """Pixels (H, W, 3) of a JPEG or PNG as stored, whatever its EXIF orientation says; None: broken or cut short."""
    if not data or not has_end_marker(data, codec):
        return None
    flags = cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    return None if pixels is None else np.asarray(pixels, np.uint8)


def decode_grey(data: bytes) -> UInt8 | None:
    """Pixels (H, W) of a one-channel PNG; None: broken."""
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if data else None
    return None if pixels is None else np.asarray(pixels, np.uint8)


def split_planes(pixels: UInt8, planes: UInt8) -> None:
    """Write the channels of (H, W, 3) pixels into contiguous planes (3, H, W)."""
    cv2.mixChannels([pixels], [planes[0], planes[1], planes[2]], [0, 0, 1, 1, 2, 2])


def run_jobs(jobs: Sequence[Callable[[], None]], costs: Sequence[int], threads: int | None = None) -> None:
    """Run jobs on the cores of this process, the dearest first, so that none is left for the end.

    Args:
        jobs: what to run; the first error among them is raised when all have ended.
        costs: (len(jobs),) any measure of their cost.
        threads: None: one a core; 1: in this thread.
    """
    count = usable_cores() if threads is None else threads
    order = sorted(range(len(jobs)), key=lambda index: -costs[index])
    if count == 1 or len(jobs) == 1:
        for index in order:
            jobs[index]()
        return
    futures = [_pool(os.getpid(), count).submit(jobs[index]) for index in order]
    wait(futures)
    for future in futures:
        future.result()


def usable_cores() -> int:
    """Cores that this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


_pool_lock = threading.Lock()


@cache
def _made_pool(process: int, threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, thread_name_prefix="mirror-decode")


def _pool(process: int, threads: int) -> ThreadPoolExecutor:
    # By process: a child must not inherit a pool whose threads stayed behind.
    with _pool_lock:
        return _made_pool(process, threads)
